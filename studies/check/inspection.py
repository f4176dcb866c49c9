"""The study behind `linkplan check`: a mechanism's properties, its reach, and its faults."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from msgspec import UNSET, Struct, UnsetType, field

from linkplan.models.audit import audit
from linkplan.models.closure.initial_assembly import keyframe_of
from linkplan.models.closure.newton import OPEN_M
from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.errors import AssemblyError, ProblemError, listed
from linkplan.models.foreign.floating import floating_sentence
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import RANGE_ROUNDING, ball_angles, shut_balls
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.body_angles import turning_bodies
from linkplan.models.poses.contacts import ContactPair, contact_pairs
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.models.poses.reach import Reach, reach, toggles
from linkplan.models.tree.dynamics import site_names
from linkplan.models.tree.joints import shown_by_unit
from linkplan.planner.files.structs import NOT_READ, Beside, Number
from linkplan.planner.problem.motion import check_asked_pose
from linkplan.studies.check.drives import (
    feeble_drives,
    floating_columns,
    motors_hint,
    outside_at_home,
    pressed_stops,
    pushed_one_way,
    range_words,
    steerable_columns,
    undriven,
)
from linkplan.studies.check.findings import coincident_sites, contact_findings, stray_pins, tendon_findings
from linkplan.studies.check.kinematic_loop_report import KinematicLoopPath, thinned
from linkplan.studies.check.softness import massless_findings, softness_note, units_notes

# Number of poses checked for contacts; a robot of a hundred bodies takes 1 ms per pose.
_MOST_CONTACT_POSES = 6000


class PoseReport(Struct, frozen=True, kw_only=True, eq=False):
    """The mechanism at one pose: inertia (n_s, n_s), holding efforts without and with all forces, and the effort map.

    Efforts are on the independent joints, by name; the map is by actuator and joint.
    """

    q_deg: dict[str, float]
    q_m: dict[str, float]
    reduced_inertia_kgm2: np.ndarray
    gravity_effort: dict[str, float]
    holding_effort: dict[str, float]
    effort_map: dict[str, dict[str, float]]


class Inspection(Struct, frozen=True, kw_only=True, eq=False):
    """The findings of `check`; `problems` are sentences, empty for a mechanism without faults.

    The gaps are the largest at home: "m" for points and slides, "rad" for angles, hinges and tendons. `branch` has the
    determinants of J_z's blocks at home. A reach has both ends; `reach_ends` says what ends it. `contacts` are pairs of
    geoms.
    """

    name: str = field(name="model")
    dof: int
    independent: list[str]
    dependent: list[str]
    closures: list[str]
    closure_rows: int
    closure_rank: int
    closure_gap_m: float
    closure_gap_rad: float | UnsetType = UNSET
    branch: list[float]
    home_deg: dict[str, float]
    home_m: dict[str, float]
    reach_deg: dict[str, tuple[Number, Number]]
    reach_m: dict[str, tuple[Number, Number]]
    reach_ends: dict[str, tuple[str, str]]
    singular_deg: list[float]
    branching_deg: list[float]
    toggle_deg: list[float]
    actuators: dict[str, dict[str, Any]]
    contacts: list[dict[str, Any]]
    problems: tuple[str, ...]
    notes: tuple[str, ...]
    sites_at_home_m: dict[str, np.ndarray]
    bodies_at_home_deg: dict[str, float]
    points: tuple[PoseReport, ...]
    mechanism: Beside[Mechanism] = NOT_READ
    reaches: Beside[tuple[Reach, ...]] = NOT_READ
    pairs: Beside[tuple[ContactPair, ...]] = NOT_READ


def inspect(
    mechanism: Mechanism,
    positions: list[dict[str, float]],
    *,
    motion: KinematicLoopPath | None = None,
    contacts: str = "refuse",
    on_ground: bool = False,
) -> Inspection:
    """Return the inspection of a mechanism, with a report at each of `positions` (joint name to position [rad or m]).

    For a problem, contacts are judged along its `motion` by its setting `contacts`. The base of a mechanism that stands
    `on_ground` may float.
    """
    reaches = tuple(reach(mechanism, column) for column in range(mechanism.dof))
    floating = floating_columns(mechanism)
    swept = [can.poses_once for can in reaches if can.coordinate not in floating] or [mechanism.home[None]]
    swept = [thinned(poses, max(2, _MOST_CONTACT_POSES // len(swept))) for poses in swept]
    poses, sweeps = np.vstack(swept), [len(one) for one in swept]
    touching = contact_pairs(mechanism, poses)
    problems, notes = _findings(mechanism, reaches, floats=on_ground)
    refused, noted = contact_findings(mechanism, touching, sweeps, motion, contacts)
    return Inspection(
        name=mechanism.name,
        dof=mechanism.dof,
        independent=[joint.name for joint in mechanism.independent_joints],
        dependent=[mechanism.joints[i].name for i in mechanism.dependent],
        closures=list(mechanism.closure_names),
        closure_rows=mechanism.n_closure_rows,
        closure_rank=len(mechanism.closure_rows),
        **{f"closure_gap_{unit}": gap for unit, gap in ({"m": 0.0} | _closure_gaps(mechanism)).items()},
        branch=np.array(mechanism.dynamics.block_singularity(mechanism.home)).ravel().tolist() if mechanism.closures else [],
        **_by_kind("home", mechanism, mechanism.home),
        **_reach_values(mechanism, reaches),
        actuators={
            a.name: {
                "joint": None if a.joint is None else mechanism.joints[a.joint].name,
                "on": a.target,
                "limit": [a.lower, a.upper],
                "unit": a.unit,
            }
            for a in mechanism.actuators
        },
        contacts=[{"geoms": pair.geoms, "poses": len(pair.poses), "depth_m": pair.depth_m} for pair in touching],
        problems=tuple(dict.fromkeys([*problems, *refused])),
        notes=(*notes, *noted),
        sites_at_home_m={
            name: places_of(mechanism, int(mechanism.model.site(name).id), mechanism.home)[0]
            for name in site_names(mechanism.model)
        },
        bodies_at_home_deg={
            name: float(np.degrees(sigma @ mechanism.home)) for name, sigma in turning_bodies(mechanism).items()
        },
        points=tuple(pose_report(mechanism, asked) for asked in positions),
        mechanism=mechanism,
        reaches=reaches,
        pairs=touching,
    )


def _reach_values(mechanism: Mechanism, reaches: Sequence[Reach]) -> dict[str, Any]:
    """Return the ends of each independent joint's reach, and the singular poses and turning points along it."""
    reached = list(zip(mechanism.independent_joints, reaches, strict=True))
    hinges = [(joint, can) for joint, can in reached if joint.kind == "hinge"]
    ends = {joint.name: (joint.shown(can.lower.position), joint.shown(can.upper.position)) for joint, can in reached}
    return {
        "reach_deg": {joint.name: ends[joint.name] for joint, _ in hinges},
        "reach_m": {joint.name: ends[joint.name] for joint, _ in reached if joint.kind == "slide"},
        "reach_ends": {joint.name: (can.lower.reason, can.upper.reason) for joint, can in reached},
        "singular_deg": [joint.shown(position) for joint, can in hinges for position in can.singular],
        "branching_deg": [joint.shown(position) for joint, can in hinges for position, _ in can.branching],
        "toggle_deg": [joint.shown(x) for joint, can in hinges for _, x in toggles(mechanism, can.coordinate)],
    }


def _by_kind(name: str, mechanism: Mechanism, pose: np.ndarray) -> dict[str, Any]:
    """Return a pose as two tables: `name`_deg for the hinges and `name`_m for the slides."""
    return {f"{name}_{unit}": positions for unit, positions in shown_by_unit(mechanism.joints, pose).items()}


def pose_report(mechanism: Mechanism, asked: dict[str, float]) -> PoseReport:
    """Return the report at the pose with the given positions of the named joints, on the home branch.

    Raises:
        ProblemError: if a named joint is dependent, or the pose is out of reach.
    """
    pose = asked_pose(mechanism, asked)
    dynamics, still = mechanism.dynamics, np.zeros(mechanism.dof)
    names = [joint.name for joint in mechanism.independent_joints]
    weight, held = dynamics.gravity_effort(pose), dynamics.inverse_dynamics(pose, still, still)
    by_actuator = zip(mechanism.actuators, np.array(dynamics.effort_map(pose)).T, strict=True)
    return PoseReport(
        **_by_kind("q", mechanism, pose),
        reduced_inertia_kgm2=np.array(dynamics.reduced_inertia(pose)),
        gravity_effort=dict(zip(names, np.array(weight).ravel(), strict=True)),
        holding_effort=dict(zip(names, np.array(held).ravel(), strict=True)),
        effort_map={actuator.name: dict(zip(names, column, strict=True)) for actuator, column in by_actuator},
    )


def asked_pose(mechanism: Mechanism, asked: dict[str, float]) -> np.ndarray:
    """Return the pose (n_q,) with the given positions of the named joints, on the home branch.

    Raises:
        ProblemError: if a named joint is dependent, or the pose is out of reach.
    """
    indices = {mechanism.joint_index(name, ProblemError): value for name, value in asked.items()}
    s = mechanism.home[mechanism.independent].copy()
    for index, value in indices.items():
        if index not in mechanism.independent:
            names = ", ".join(joint.name for joint in mechanism.independent_joints)
            raise ProblemError(
                f"a pose names independent joints ({names}); {mechanism.joints[index].name} follows from them"
            )
        s[list(mechanism.independent).index(index)] = value
    check_asked_pose(mechanism, asked)
    try:
        return close_at(mechanism, s)
    except AssemblyError as error:
        raise ProblemError(f"the requested pose is beyond reach: {error}") from error


def _closure_gaps(mechanism: Mechanism) -> dict[str, float]:
    """Return the largest gaps by unit at home and, if a loop is open there, at the model's reference pose."""
    open_there = mechanism.home_gap_m > OPEN_M
    gaps: dict[str, float] = {}
    for pose in (mechanism.home, *([mechanism.reference] if open_there else [])):
        for unit, gap in mechanism.gaps_by_unit(pose[None]).items():
            gaps[unit] = max(gaps.get(unit, 0.0), float(gap[0]))
    return dict(sorted(gaps.items())) or {"m": 0.0}


def _open_loops(mechanism: Mechanism) -> str:
    """Return the names and gaps of the closures open at the model's reference pose: points in mm, angles in rad."""
    phi, names = np.array(mechanism.dynamics.closure(mechanism.reference)).ravel(), []
    widest: dict[str, float] = {}
    for closure in mechanism.closures:
        gap = float(closure.gap(phi))
        if gap > (OPEN_M if closure.unit == "m" else OPEN_M / mechanism.extent_m):
            names.append(closure.name)
            widest[closure.unit] = max(widest.get(closure.unit, 0.0), gap)
    by = [f"{1e3 * gap:.3g} mm" if unit == "m" else f"{gap:.3g} rad" for unit, gap in sorted(widest.items())]
    return f"{', '.join(dict.fromkeys(names))} is open by {' and '.join(by)}"


def _findings(mechanism: Mechanism, reaches: tuple[Reach, ...], *, floats: bool) -> tuple[list[str], list[str]]:
    """Return the problems, and notes on findings that are not faults, each a sentence; its base may float if `floats`."""
    problems, notes = _home_findings(mechanism)
    reached = np.abs(np.array(mechanism.dynamics.effort_map(mechanism.home))).max(axis=1, initial=0.0)
    driven = {
        int(i) for i, most in zip(mechanism.independent, reached, strict=True) if most > ROUNDING_SHARE * reached.max()
    }
    steerable = steerable_columns(mechanism) if driven else np.zeros(mechanism.dof, dtype=bool)
    base, floating = floating_sentence(mechanism.model), floating_columns(mechanism)
    problems += [] if base is None or floats else [base]
    for can in reaches:
        if can.coordinate in floating:
            continue
        idle = bool(driven) and int(mechanism.independent[can.coordinate]) not in driven and mechanism.n_u < mechanism.dof
        faults, facts = _coordinate_findings(mechanism, can, idle=idle, steerable=bool(steerable[can.coordinate]))
        problems += faults
        notes += facts
    notes += feeble_drives(mechanism)
    beyond, ends = tendon_findings(mechanism, reaches)
    problems += [*beyond, *coincident_sites(mechanism)]
    notes += ends
    for item in audit(mechanism.model):
        (problems if item.falsifies else notes).append(f"neglected in plans: {item.text}" if item.falsifies else item.text)
    return problems, notes


def _coordinate_findings(mechanism: Mechanism, can: Reach, *, idle: bool, steerable: bool) -> tuple[list[str], list[str]]:
    """Return the problems and notes on an independent joint; `idle` if no actuator acts on it at home."""
    problems, notes, column = [], [], can.coordinate
    passive = not mechanism.actuated[column]
    if idle and mechanism.independent[column] not in mechanism.passive_dofs:
        sentence, fault = undriven(mechanism, column, steerable=steerable)
        (problems if fault else notes).append(sentence)
    one_sided = pushed_one_way(mechanism, column)
    problems += [] if one_sided is None else [one_sided]
    notes += [sentence for upper in (False, True) if (sentence := _stop_note(mechanism, can, upper=upper)) is not None]
    notes += _singular_notes(mechanism, can)
    return problems, notes if passive else [*notes, *_toggle_notes(mechanism, can)]


def _home_findings(mechanism: Mechanism) -> tuple[list[str], list[str]]:
    """Return the problems and notes on the home pose, closures, masses, actuators and keyframes."""
    problems, notes = [], []
    if mechanism.home_gap_m > OPEN_M:
        loops = f"loop {_open_loops(mechanism)} at the model's reference pose"
        if mechanism.source.keys() & {"home_deg", "home_m"}:
            notes.append(f"{loops}, and closed at mechanism.home_deg, from which linkplan starts")
        else:
            problems.append(f"{loops}: the simulator closes it abruptly")
        notes.append(f"this keyframe in the model closes it: {keyframe_of(mechanism.coordinates, mechanism.home)}")
    problems += outside_at_home(mechanism)
    for ball, angle in zip(mechanism.balls, ball_angles(mechanism, mechanism.home[None])[0], strict=True):
        if angle > ball.largest + RANGE_ROUNDING and ball.largest:
            by, most = np.degrees([angle, ball.largest])
            problems.append(f"ball joint {ball.name} is turned by {by:.4g} deg at home, beyond its range of {most:.4g} deg")
    problems += [sentence for sentence in (shut_balls(mechanism),) if sentence is not None] + pressed_stops(mechanism)
    notes += [*units_notes(mechanism), *stray_pins(mechanism)]
    if not mechanism.closure_names:
        notes.append("the model has no active loop closure: it is an open tree")
    soft = softness_note(mechanism)
    notes += [] if soft is None else [soft]
    problems += [*massless_findings(mechanism), *mechanism.faults]
    if mechanism.n_u == 0:
        problems.append(f"the model has no actuator that a plan can use: {motors_hint(mechanism)}")
    named = [name for k in range(mechanism.model.nkey) if (name := mechanism.model.key(k).name)]
    if named and "home" not in named and not mechanism.source.keys() & {"home_deg", "home_m"}:
        notes.append(
            f"home is the reference pose, because none of the model's keyframes ({', '.join(named)}) is named home; use"
            " mechanism.home_deg or mechanism.keyframe for another pose"
        )
    return problems, [*mechanism.notes, *notes] if mechanism.selection else [*notes, *mechanism.notes]


def _stop_note(mechanism: Mechanism, can: Reach, *, upper: bool) -> str | None:
    """Return the sentence on another joint that ends a reach; None if no other joint does.

    It names the coordinate's own range, unless there is none or it ends within 1 % of the stop.
    """
    end, pose = (can.upper, can.poses[-1]) if upper else (can.lower, can.poses[0])
    index = int(mechanism.independent[can.coordinate])
    if end.joint is None or end.joint == index:
        return None
    joint, other = mechanism.joints[index], mechanism.joints[end.joint]
    stop = f"joint {other.name}'s range {range_words(other)} stops the mechanism at {joint.name} ="
    stop += f" {joint.text(end.position, 4)} {joint.unit}"
    distance = abs(end.position - (joint.upper if upper else joint.lower))
    if not np.isfinite([joint.lower, joint.upper]).any() or distance <= 0.01 * (joint.upper - joint.lower):
        return stop
    if other.kind == "slide" and joint.kind == "hinge":
        return f"{stop}, within {joint.name}'s own range {range_words(joint)}"
    # Other coordinates that move the joint, except passive ones, can move it off its stop.
    rates = np.abs(np.array(mechanism.dynamics.velocity_map(pose))[end.joint])
    if np.any(np.delete(rates * mechanism.actuated, can.coordinate) > ROUNDING_SHARE * rates.max()):
        return f"{stop} while the other coordinates stay at home ({joint.name}'s own range: {range_words(joint)})"
    return f"{stop} ({joint.name}'s own range: {range_words(joint)})"


def _singular_notes(mechanism: Mechanism, can: Reach) -> list[str]:
    """Return a sentence on each singular pose of a reach: a dead centre of its coordinate, or a branching pose."""
    joint, branching, said = mechanism.joints[mechanism.independent[can.coordinate]], dict(can.branching), []
    for position in can.singular:
        at = f"singular pose at {joint.name} = {joint.text(position, 5)} {joint.unit}"
        if position not in branching:
            said.append(
                f"{at}: {joint.name} is at a dead centre. The mechanism can pass it, but not with {joint.name} as its"
                " coordinate: set mechanism.independent to another joint"
            )
            continue
        branches = (
            "Only one motion passes this pose, so the mechanism stays on its branch"
            if position in can.single
            else "The mechanism may change to another branch there"
        )
        said.append(
            f"{at}: the closure's rank falls from {len(mechanism.dependent)} to {branching[position]}, for any choice of"
            f" coordinate. {branches}; the loop forces become infinite"
        )
    return said


def _toggle_notes(mechanism: Mechanism, can: Reach) -> list[str]:
    """Return the sentence on a coordinate's toggle poses, if any: up to four turning points of each dependent joint."""
    joint = mechanism.joints[mechanism.independent[can.coordinate]]
    turn = np.inf if can.period is None else can.period
    by_joint: dict[int, list[float]] = {}
    for other, position in toggles(
        mechanism, can.coordinate
    ):  # for a joint that turns continuously: each pose once per period, to a microradian
        found = by_joint.setdefault(other, [])
        known = [abs((position - one + turn / 2) % turn - turn / 2) if np.isfinite(turn) else np.inf for one in found]
        if min(known, default=np.inf) > 1e-6:
            found.append(position)
    said = []
    for other, positions in by_joint.items():
        places = listed([joint.text(x, 5) for x in positions], 4)
        said.append(f"joint {mechanism.joints[other].name} turns back at {joint.name} = {places} {joint.unit}")
    every = "turn" if can.upper.reason == "full turn" else can.upper.reason
    again = "" if can.period is None else f", and again every {every}"
    return [f"toggle poses: {'; '.join(said)}{again}"] if said else []
