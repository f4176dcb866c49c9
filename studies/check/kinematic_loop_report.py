"""The kinematic loop report along a path: ratios, inertias, weight, available effort, singular poses, pin forces.

    r = Gamma^T B,   M_r = Gamma^T M Gamma,   1 / m_j = r_j^T M_r^-1 r_j

r (n_s, n_u) is the effort on a coordinate per effort of an actuator and, by virtual work, the actuator's speed per speed of
the coordinate. m_j is the reflected inertia at actuator j with the other coordinates free (Khatib, IEEE J. Robotics and
Automation 3, 1987, for a point; here for an actuator's length). Efforts and forces are at rest.
"""

import functools
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.coordinate_choice import is_regular, singular_inertia_text
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import distributed, sampled
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.joint_forces import JointForces, joint_forces, pins_of
from linkplan.models.poses.period import turn_of
from linkplan.models.poses.reach import Reach
from linkplan.models.poses.sign_change import sign_change
from linkplan.models.reduction.reduced import ReducedDynamics
from linkplan.models.transfer.polytope import effort_box
from linkplan.models.tree.joints import where
from linkplan.planner.closed_chain.guess import GUESS_SAMPLES, first_guess, follows_reference, poses_along
from linkplan.planner.limits.kinds import effort_bounds
from linkplan.planner.limits.samples import singularity_ratios
from linkplan.planner.problem.problem import Problem
from linkplan.studies.check.spring_ratios import spring_motion

# An effort is zero at a root if it is less than this share of the largest effort nearby. This excludes poles, at which the
# effort changes its sign through infinity.
_ZERO_SHARE = 1e-6


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Balance:
    """A pose in balance: the coordinate's position [rad or m], and whether it returns there."""

    position: float
    stable: bool


def balances(mechanism: Mechanism, poses: np.ndarray, needed: np.ndarray, coordinate: int) -> tuple[Balance, ...]:
    """Return the poses in balance between neighbouring poses (n, n_q) of a coordinate's path, by position.

    Args:
        mechanism: of the path.
        poses: along it.
        needed: the effort (n,) on the coordinate that holds them at rest.
        coordinate: the swept independent joint's column.
    """
    largest = float(np.abs(needed[np.isfinite(needed)]).max(initial=0.0))
    found: dict[float, Balance] = {}
    still = np.zeros((1, mechanism.dof))
    for k in np.flatnonzero(needed[:-1] * needed[1:] <= 0):
        ends, (low, high) = np.abs(needed[k : k + 2]), poses[k : k + 2, mechanism.independent]
        if not ROUNDING_SHARE * largest < ends.max():  # no effort is needed on a whole interval
            continue

        def effort(share: Any, low: np.ndarray = low, high: np.ndarray = high, begin: np.ndarray = poses[k]) -> float:
            on_branch = follow(mechanism, (low + float(share) * (high - low))[None], begin)
            return sampled(mechanism.dynamics.inverse_dynamics, on_branch, still, still)[0, coordinate, 0]

        try:
            share = float(sign_change(effort, 0.0, 1.0, 1e-12))
            rest = abs(effort(share))
        except AssemblyError:
            continue
        step = high[coordinate] - low[coordinate]
        if np.isfinite(share) and rest <= _ZERO_SHARE * ends.max() and step:
            position = float(low[coordinate] + share * step)
            found[round(position, 9)] = Balance(position=position, stable=bool((needed[k + 1] - needed[k]) / step > 0))
    return tuple(found[position] for position in sorted(found))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Sweep:
    """A mechanism along a path of n poses (n, n_q).

    `coordinate` is the independent joint that moves over its reach while the others stay at home; None along a problem's
    motion.
    """

    mechanism: Mechanism
    title: str
    coordinate: int | None
    poses: np.ndarray

    @property
    def positions(self) -> np.ndarray:
        """The independent positions (n, n_s) [rad or m]."""
        return self.poses[:, self.mechanism.independent]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class KinematicLoopPath(Sweep):
    """The report along a path, at rest at each of its poses.

    A problem's motion has times `time_s` (n,). Efforts on hinges are in [N.m], on slides in [N]; efforts of actuators are in
    the actuator's unit.
    """

    time_s: np.ndarray | None
    reduced_inertia: np.ndarray  # (n, n_s, n_s)
    ratio: np.ndarray  # (n, n_s, n_u) effort on a coordinate per effort of an actuator
    rates: np.ndarray  # (n, n_q, n_s) every joint's speed per speed of a coordinate
    reflected_inertia: np.ndarray  # (n, n_u), others free; infinite without motion, nan if M_r is singular
    gravity_effort: np.ndarray  # (n, n_s) that holds the weight
    holding_effort: np.ndarray  # (n, n_u) of the actuators that hold weight and springs
    unheld_effort: np.ndarray  # (n, n_s) missing part of the holding effort, which the actuators cannot provide
    available_effort: np.ndarray  # (n, n_s, 2) least and largest effort on each coordinate within the actuators' limits
    limit: np.ndarray  # (n_u, 2) of the actuators' efforts
    singularity: np.ndarray  # (n,) least determinant of J_z's blocks relative to home; 0 at a singular pose
    closure_force: np.ndarray  # (n, n_closures) [N] norm of each closure's force while weight and springs are held
    places: np.ndarray  # (n, 3, n_sites) [m] of the model's sites
    spring_length: np.ndarray  # (n, n_t) [m] of the tendons with springs, in the order of `sprung_tendons`
    spring_ratio: np.ndarray  # (n, n_t, n_s) their motion ratios: speed per speed of a coordinate
    balances: tuple[Balance, ...]  # along a coordinate's path

    @property
    def needed(self) -> np.ndarray:
        """The effort (n, n_s) on each coordinate that holds the pose at rest; rounding errors are set to zero."""
        needed = np.einsum("ksu,ku->ks", self.ratio, self.holding_effort) + self.unheld_effort
        return np.where(np.abs(needed) > ROUNDING_SHARE * np.abs(needed).max(initial=0.0), needed, 0.0)

    @property
    def joint_forces(self) -> JointForces:
        """The forces and moments in all closures and pins at rest, under the holding effort."""
        return _forces_at_rest(self)

    @property
    def pin_force(self) -> np.ndarray:
        """The size (n, n_pins) [N] of the force in each pin of the tree at rest."""
        return self._of_pins(self.joint_forces.force)

    @property
    def pin_moment(self) -> np.ndarray:
        """The size (n, n_pins) [N.m] of the moment in each pin of the tree at rest, across its axes."""
        return self._of_pins(self.joint_forces.moment)

    def _of_pins(self, sizes: Mapping[str, np.ndarray]) -> np.ndarray:
        none = np.zeros(len(self.poses))
        found = [sizes.get(pin.name, none) for pin in pins_of(self.mechanism)]
        return np.array(found).T.reshape(len(none), -1)

    @property
    def shown_poses(self) -> np.ndarray:
        """The poses (n, n_q) [deg or m]."""
        return self.poses * [joint.shown(1.0) for joint in self.mechanism.joints]

    @property
    def own_inertia(self) -> np.ndarray:
        """The reduced inertia (n, n_s) of each coordinate, the others at rest."""
        return self.reduced_inertia.diagonal(axis1=1, axis2=2)


def measure(
    mechanism: Mechanism,
    poses: np.ndarray,
    title: str,
    *,
    coordinate: int | None = None,
    time_s: np.ndarray | None = None,
    limit: np.ndarray | None = None,
) -> KinematicLoopPath:
    """Return the report along closed poses (n, n_q). By default, `limit` (n_u, 2) are the actuators' own limits."""
    dynamics, limit = mechanism.dynamics, mechanism.effort_limit if limit is None else limit
    still = np.zeros((len(poses), mechanism.dof))
    ratio = sampled(dynamics.effort_map, poses)
    pushes = np.abs(ratio) > ROUNDING_SHARE * np.abs(ratio).max(axis=(0, 1), initial=0.0)
    inertia = sampled(dynamics.reduced_inertia, poses)
    weight = sampled(_at_rest(dynamics), poses)[:, :, 0]
    holding = distributed(mechanism, weight, ratio, limit)
    unheld = weight - np.einsum("ksu,ku->ks", ratio, holding)
    force = sampled(dynamics.closure_force, poses, still, still, holding)[:, :, 0]
    rates = sampled(dynamics.velocity_map, poses)
    spring_length, spring_ratio = spring_motion(mechanism, poses, rates)
    sizes = [np.linalg.norm(force[:, mechanism.closure_slice(c)], axis=1) for c in range(len(mechanism.closure_names))]
    return KinematicLoopPath(
        mechanism=mechanism,
        title=title,
        coordinate=coordinate,
        time_s=time_s,
        poses=poses,
        ratio=ratio,
        rates=rates,
        reduced_inertia=inertia,
        reflected_inertia=reflected(ratio, inertia),
        gravity_effort=sampled(dynamics.gravity_effort, poses)[:, :, 0],
        holding_effort=holding,
        unheld_effort=unheld,
        available_effort=effort_box(np.where(pushes, ratio, 0.0).transpose(0, 2, 1), limit),
        limit=limit,
        singularity=singularity_ratios(mechanism, poses),
        closure_force=np.array(sizes).T.reshape(len(poses), -1),
        places=sampled(dynamics.site_places, poses),
        spring_length=spring_length,
        spring_ratio=spring_ratio,
        balances=() if coordinate is None else balances(mechanism, poses, weight[:, coordinate], coordinate),
    )


@functools.lru_cache(maxsize=1)
def _forces_at_rest(path: KinematicLoopPath) -> JointForces:
    still = np.zeros((len(path.poses), path.mechanism.dof))
    return joint_forces(path.mechanism, path.poses, still, still, path.holding_effort)


@functools.lru_cache(maxsize=16)
def _at_rest(dynamics: ReducedDynamics) -> ca.Function:
    """Return q -> the generalised effort (n_s,) that holds a pose, 8 times as fast as inverse dynamics."""
    inverse = dynamics.inverse_dynamics
    q, still = ca.SX.sym("q", inverse.size1_in(0)), ca.SX.zeros(inverse.size1_in(1))
    return ca.Function("at_rest", [q], [ca.densify(inverse(q, still, still))])


def measured(of: Sweep) -> KinematicLoopPath:
    """Return the report along a path; a path that already is a report is returned unchanged."""
    return of if isinstance(of, KinematicLoopPath) else measure(of.mechanism, of.poses, of.title, coordinate=of.coordinate)


def reach_sweeps(mechanism: Mechanism, reaches: Sequence[Reach]) -> tuple[Sweep, ...]:
    """Return the sweep of each independent joint over its reach."""
    found = []
    for can in reaches:
        column = can.coordinate
        if not mechanism.actuated[column]:
            continue  # the spin of a rod about its axis changes nothing
        name = mechanism.joints[mechanism.independent[column]].name
        others = ", the other coordinates at home" if mechanism.dof > 1 else ""
        poses = thinned(swept(mechanism, can), most_poses(mechanism))
        found.append(Sweep(mechanism=mechanism, title=f"the reach of {name}{others}", coordinate=column, poses=poses))
    return tuple(found)


def room_for_poses(mechanism: Mechanism) -> int:
    """Return the number of poses per path for which a record has a million numbers, about ten megabytes in JSON."""
    return 1_000_000 // (mechanism.dof**2 * (mechanism.n_q + mechanism.dof + mechanism.n_u))


def has_whole_records(mechanism: Mechanism) -> bool:
    """Tell if the record of a path has every coordinate; beyond about 25 coordinates it only has the path's own."""
    return room_for_poses(mechanism) >= 25


def most_poses(mechanism: Mechanism) -> int:
    """Return the number of poses of a coordinate's path that fit into a record: all, for up to seven coordinates."""
    return max(25, room_for_poses(mechanism))


def thinned(poses: np.ndarray, most: int) -> np.ndarray:
    """Return all poses, or `most` evenly spaced ones with the first and the last."""
    return poses if len(poses) <= most else poses[np.linspace(0, len(poses) - 1, most).round().astype(int)]


def swept(mechanism: Mechanism, can: Reach) -> np.ndarray:
    """Return the poses of a reach; without stops, those of a hinge's period, or of a slide by one extent to either side."""
    index = mechanism.independent[can.coordinate]
    if can.period is not None:
        turns = can.period / turn_of(mechanism, can.coordinate)
        s = np.tile(mechanism.home[mechanism.independent], (360 * max(1, round(turns)) + 1, 1))
        s[:, can.coordinate] += np.linspace(0.0, can.period, len(s))
        return follow(mechanism, s)
    if not can.turns_fully or mechanism.joints[index].kind == "hinge":
        return _finer(mechanism, can.poses)
    travel = can.poses[:, index] - mechanism.home[index]
    return _finer(mechanism, can.poses[np.abs(travel) <= (1 + 1e-9) * mechanism.extent_m])


def _finer(mechanism: Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return at least `GUESS_SAMPLES` poses, with the same number of poses inserted between each two."""
    parts = int(np.ceil((GUESS_SAMPLES - 1) / max(1, len(poses) - 1)))
    if parts == 1:
        return poses
    places = poses[:, mechanism.independent]
    shares = np.arange(1, parts)[:, None] / parts
    gaps = [one + shares * (other - one) for one, other in pairwise(places)]
    try:
        between = follow(mechanism, np.concatenate(gaps), poses[0]).reshape(len(gaps), parts - 1, -1)
    except (AssemblyError, ValueError):  # near a singular pose, or if the reach is a single point
        between = [np.empty((0, mechanism.n_q))] * len(gaps)
        for k, (gap, one) in enumerate(zip(gaps, poses, strict=False)):
            with suppress(AssemblyError):
                between[k] = follow(mechanism, gap, one)
    rows = [row for one, inside in zip(poses, between, strict=False) for row in (one, *inside)]
    return np.array([*rows, poses[-1]])


def motion_path(problem: Problem) -> KinematicLoopPath:
    """Return the report along a problem's motion before any solve: its reference, or its smooth path.

    Raises:
        ProblemError: if start, goal or reference are out of reach.
        AssemblyError: if the loops do not close along the path.
    """
    mechanism = problem.mechanism
    guess = first_guess(problem, problem.start_pose())
    time = np.linspace(0.0, guess.duration_s, GUESS_SAMPLES)
    title = f"the {'reference' if follows_reference(problem) else 'smooth path'} of {problem.name}"
    poses = poses_along(mechanism, guess, time)
    return measure(mechanism, poses, title, time_s=time, limit=effort_bounds(problem))


def inertia_notes(path: Sweep) -> list[str]:
    """Return a sentence on the poses of a path at which the reduced inertia is singular, if there are any."""
    inertia = sampled(path.mechanism.dynamics.reduced_inertia, path.poses)
    singular = np.flatnonzero(~is_regular(inertia))
    if not len(singular):
        return []
    k, joints = int(singular[0]), path.mechanism.independent_joints
    of = list(range(len(joints))) if path.coordinate is None else [path.coordinate]
    at = where([joints[i] for i in of], path.positions[k, of])
    return [
        f"singular inertia at {at}, in {len(singular)} of {len(path.poses)} poses along {path.title}:"
        f" {singular_inertia_text(joints, inertia[k])} there, so no effort determines their acceleration"
    ]


def acts(path: KinematicLoopPath) -> np.ndarray:
    """Return the mask (n_s, n_u) of the coordinates on which each actuator acts somewhere along a path."""
    most = np.abs(path.ratio).max(axis=0)
    return most > ROUNDING_SHARE * most.max(axis=0, initial=0.0)


def reflected(ratio: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Return 1 / (r_j^T M^-1 r_j) (n, n_u): infinite if r_j is zero, nan if M is singular."""
    regular = is_regular(inertia)
    found = np.full((len(ratio), ratio.shape[2]), np.nan)
    mobility = np.einsum("ksu,ksu->ku", ratio[regular], np.linalg.solve(inertia[regular], ratio[regular]))
    found[regular] = np.divide(1.0, mobility, out=np.full_like(mobility, np.inf), where=mobility > 0)
    return found
