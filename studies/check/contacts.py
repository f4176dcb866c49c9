"""Which contacts of a motion in phases can hold a pose at rest: the forces of the ground and the efforts, or what lacks."""

from collections.abc import Sequence

import casadi as ca
import numpy as np
from msgspec import Struct

from linkplan.models.actuation.distribution import HOLDING_TOLERANCE, distribute
from linkplan.models.ground import ground_of
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import demanded
from linkplan.models.poses.whole_body import total_mass, unit_acceleration
from linkplan.models.tree.joints import unit_steps
from linkplan.planner.problem.phases import PhasedProblem
from linkplan.planner.search.phase_poses import phase_poses
from linkplan.studies.output.document import Block, Text, table_of

# Edges of the pyramid in the friction cone.
_PYRAMID_EDGES = 16


class StandingPose(Struct, frozen=True, kw_only=True):
    """A pose in which a phase's contacts stand on the ground, at rest.

    Args:
        phase: its name.
        when: "start" or "end".
        on: the contacts.
        force_n: the force of the ground by site (3,), in the directions of the world [N].
        effort: of the actuators by name [N.m or N].
        lacking: the largest effort that a joint lacks [N.m, or N of slides]; zero if the pose can be held.
        joint: the joint that lacks it; empty otherwise.
        unit: of what it lacks.
    """

    phase: str
    when: str
    on: tuple[str, ...]
    force_n: dict[str, tuple[float, float, float]]
    effort: dict[str, float]
    lacking: float
    joint: str
    unit: str


def standing_poses(asked: PhasedProblem) -> list[StandingPose]:
    """Return whether each phase's contacts can hold the poses guessed for its start and end.

    The forces and efforts are those of least squares in units of the weight and of the largest efforts, with pushes at least
    zero and within a pyramid in the friction cone.

    Raises:
        ProblemError: if there is no pose with the contacts of a phase.
    """
    at, found = phase_poses(asked), []
    for k, phase in enumerate(asked.phases):
        for end, when in enumerate(("start", "end") if phase.on else ()):
            found.append(_standing(asked, k, at.bare[k], at.poses[k + end], when))
    return found


def _standing(asked: PhasedProblem, k: int, mechanism: Mechanism, pose: np.ndarray, when: str) -> StandingPose:
    contacts = asked.phases[k].on
    names = [site for contact in contacts for site in asked.sites_of(contact)]
    frictions = [asked.sections.contacts[contact].friction for contact in contacts for _ in asked.sites_of(contact)]
    still, weight = np.zeros((1, mechanism.dof)), total_mass(mechanism) * unit_acceleration(mechanism)
    tau, maps = demanded(mechanism, pose[None], still, still)
    gamma = np.array(mechanism.dynamics.velocity_map(pose))
    grounds = [
        ground_of(mechanism.model, asked.sections.contacts[one].plane) for one in contacts for _ in asked.sites_of(one)
    ]
    parts = [_parts(ground[3:], friction) for ground, friction in zip(grounds, frictions, strict=True)]
    pushes = [weight * gamma.T @ J.T @ of.T for J, (of, _) in zip(_site_slopes(mechanism, names, pose), parts, strict=True)]
    n_u, unit = mechanism.n_u, unit_steps(mechanism.independent_joints, mechanism.extent_m)
    every = np.hstack([maps[0], *pushes]) * unit[:, None]
    limit = np.vstack([mechanism.effort_limit, *(bounds for _, bounds in parts)])
    (held,) = distribute(tau * unit, every[None], limit)
    held = np.clip(held, *limit.T)
    missed = (tau[0] * unit - every @ held) / unit
    joint = int(np.argmax(np.abs(missed * unit)))
    lacks = abs(missed[joint] * unit[joint]) > HOLDING_TOLERANCE * weight * mechanism.extent_m
    shares = np.split(held[n_u:], np.cumsum([len(of) for of, _ in parts])[:-1])
    forces = {name: _rounded(weight * share @ of, weight) for name, share, (of, _) in zip(names, shares, parts, strict=True)}
    efforts = _rounded(held[:n_u], weight * mechanism.extent_m)
    return StandingPose(
        phase=asked.phases[k].name,
        when=when,
        on=tuple(contacts),
        force_n={name: (float(x), float(y), float(z)) for name, (x, y, z) in forces.items()},
        effort={one.name: float(u) for one, u in zip(mechanism.actuators, efforts, strict=True)},
        lacking=float(abs(missed[joint])) if lacks else 0.0,
        joint=mechanism.independent_joints[joint].name if lacks else "",
        unit="N.m" if mechanism.independent_joints[joint].kind == "hinge" else "N",
    )


def _rounded(values: np.ndarray, unit: float) -> np.ndarray:
    """Return values, with zero in place of those so small against a unit of the same kind that they are rounding."""
    return np.where(np.abs(values) > HOLDING_TOLERANCE * unit, values, 0.0)


def _parts(normal: np.ndarray, friction: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Return forces (n, 3) that add up to any of a contact, and the bounds (n, 2) of their factors.

    They are the edges of a pyramid in the friction cone, with a push of 1; without slip, the normal and two tangents.
    """
    first = np.cross(normal, [0.0, 1.0, 0.0] if abs(normal[1]) < abs(normal[2]) else [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first)
    tangents = np.stack([first, np.cross(normal, first)])
    if friction is None:
        return np.vstack([normal, tangents]), np.array([[0.0, np.inf], [-np.inf, np.inf], [-np.inf, np.inf]])
    angle = 2.0 * np.pi * np.arange(_PYRAMID_EDGES) / _PYRAMID_EDGES
    edges = normal + friction * np.column_stack([np.cos(angle), np.sin(angle)]) @ tangents
    return edges, np.tile([0.0, np.inf], (_PYRAMID_EDGES, 1))


def _site_slopes(mechanism: Mechanism, names: Sequence[str], pose: np.ndarray) -> list[np.ndarray]:
    """Return the Jacobians (3, n_q) of sites by all joints at a pose."""
    q = ca.SX.sym("q", mechanism.n_q)
    places = mechanism.dynamics.site_places(q)
    columns = [places[:, mechanism.model.site(name).id] for name in names]
    slopes = ca.Function("slopes", [q], [ca.densify(ca.jacobian(place, q)) for place in columns])
    return [np.array(one) for one in slopes.call([ca.DM(pose)])]


def standing_blocks(poses: Sequence[StandingPose]) -> list[Block]:
    """Return the table of the poses, and a sentence on each that cannot be held."""
    rows = []
    for one in poses:
        forces = "; ".join(f"{site} ({x:.5g}, {y:.5g}, {z:.5g})" for site, (x, y, z) in one.force_n.items())
        efforts = ", ".join(f"{name} {value:.5g}" for name, value in one.effort.items())
        rows.append([f"{one.phase}, {one.when}", ", ".join(one.on), not one.joint, forces, efforts])
    heads = ["pose", "on", "can be held", "forces of the ground [N]", "efforts [N.m or N]"]
    found: list[Block] = [table_of("Contacts at rest", heads, rows)]
    for one in poses:
        if one.joint:
            text = f"{one.phase}, {one.when}: {', '.join(one.on)} cannot hold the pose; {one.joint} lacks {one.lacking:.5g}"
            found.append(Text(text=f"{text} {one.unit}, so that it moves at once", tone="note"))
    return found
