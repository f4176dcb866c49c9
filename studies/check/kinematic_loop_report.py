"""The kinematic loop report along a path: ratios, inertias, weight, available effort, singular poses, pin forces.

    r = Gamma^T B,   M_r = Gamma^T M Gamma,   1 / m_j = r_j^T M_r^-1 r_j

r (n_s, n_u) is both the effort on a coordinate per unit of an actuator's effort and the actuator's speed per unit of the
coordinate's speed (virtual work). m_j is the inertia that actuator j feels, the other coordinates free (Khatib, IEEE J.
Robotics and Automation 3, 1987, for a point; here for an actuator's length). Efforts and forces are those at rest.
"""

import functools
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import least_effort, sampled, sampled_where_moving
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.reach import Reach
from linkplan.models.reduction.reduced import ReducedDynamics
from linkplan.models.reduction.regular_inertia import is_regular, singular_inertia_text
from linkplan.planner.closed_chain.guess import first_guess, poses_along
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.search.presolve import start_pose_of

# Instants at which a problem's motion is sampled: a path of a few radians is then sampled to about a degree.
_SAMPLES = 121
# Poses of a whole turn: one a degree.
_TURN_SAMPLES = 361
# Matrices of n coordinates at the poses of n paths: no more numbers than this of a quantity (in JSON, some fifty
# megabytes), which thins the paths of more than seventeen coordinates; but so many poses of each in any case.
_MOST_NUMBERS, _FEWEST = 2_000_000, 3
# An actuator whose effort on a coordinate is below this share of the largest does not act on it: rounding.
_NO_ARM = 1e-9


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class KinematicLoopPath:
    """A mechanism along a path of n poses (n, n_q), at rest at each.

    `coordinate` is the independent joint that is swept over its reach while the others stay at home, None along a problem's
    motion, which has times `time_s` (n,). Efforts are in [N.m] on a hinge or [N] on a slide, those of actuators in their own
    unit.
    """

    mechanism: Mechanism
    title: str
    coordinate: int | None
    time_s: np.ndarray | None
    poses: np.ndarray
    ratio: np.ndarray  # (n, n_s, n_u) effort on a coordinate per effort of an actuator
    rates: np.ndarray  # (n, n_q, n_s) every joint's speed per speed of a coordinate
    reduced_inertia: np.ndarray  # (n, n_s, n_s)
    reflected_inertia: (
        np.ndarray
    )  # (n, n_u) felt by an actuator, the other coordinates free; infinite where it moves nothing, nan where M_r is singular
    gravity_effort: np.ndarray  # (n, n_s) that holds the weight
    holding_effort: np.ndarray  # (n, n_u) of the actuators, the least that holds weight and springs
    unheld_effort: np.ndarray  # (n, n_s) what the actuators cannot hold, in whichever strength
    available_effort: (
        np.ndarray
    )  # (n, n_s, 2) least and most effort that the actuators' limits allow on each coordinate alone
    limit: np.ndarray  # (n_u, 2) of the actuators' efforts
    singularity: np.ndarray  # (n,) least determinant of J_z's blocks as a share of that at home; 0 at a singular pose
    closure_force: np.ndarray  # (n, n_closures) [N] size of each closure's force while weight and springs are held

    @property
    def positions(self) -> np.ndarray:
        """The independent positions (n, n_s) [rad or m]."""
        return self.poses[:, self.mechanism.independent]


def measure(
    mechanism: Mechanism,
    poses: np.ndarray,
    title: str,
    *,
    coordinate: int | None = None,
    time_s: np.ndarray | None = None,
    limit: np.ndarray | None = None,
) -> KinematicLoopPath:
    """Return the report along closed poses (n, n_q); `limit` (n_u, 2) is the actuators' own by default."""
    dynamics, limit = mechanism.dynamics, mechanism.effort_limit if limit is None else limit
    still = np.zeros((len(poses), mechanism.dof))
    ratio = sampled(dynamics.effort_map, poses)
    inertia = sampled_where_moving(dynamics.reduced_inertia, poses)
    weight = sampled_where_moving(_at_rest(dynamics), poses)[:, :, 0]
    holding = least_effort(weight, ratio)
    unheld = weight - np.einsum("ksu,ku->ks", ratio, holding)
    force = sampled_where_moving(dynamics.closure_force, poses, still, still, holding)[:, :, 0]
    sizes = [np.linalg.norm(force[:, mechanism.closure_slice(c)], axis=1) for c in range(len(mechanism.closure_names))]
    return KinematicLoopPath(
        mechanism=mechanism,
        title=title,
        coordinate=coordinate,
        time_s=time_s,
        poses=poses,
        ratio=ratio,
        rates=sampled(dynamics.velocity_map, poses),
        reduced_inertia=inertia,
        reflected_inertia=_reflected(ratio, inertia),
        gravity_effort=sampled_where_moving(dynamics.gravity_effort, poses)[:, :, 0],
        holding_effort=holding,
        unheld_effort=unheld,
        available_effort=_available(ratio, limit),
        limit=limit,
        singularity=_singularity(mechanism, poses),
        closure_force=np.array(sizes).T.reshape(len(poses), -1),
    )


@functools.lru_cache(maxsize=16)
def _at_rest(dynamics: ReducedDynamics) -> ca.Function:
    """Return q -> the generalised effort (n_s,) that holds a pose: an eighth of the inverse dynamics of a moving one."""
    inverse = dynamics.inverse_dynamics
    q, still = ca.SX.sym("q", inverse.size1_in(0)), ca.SX.zeros(inverse.size1_in(1))
    return ca.Function("at_rest", [q], [ca.densify(inverse(q, still, still))])


def reach_paths(mechanism: Mechanism, reaches: tuple[Reach, ...]) -> tuple[KinematicLoopPath, ...]:
    """Return the report over the reach of each independent joint, the others at home."""
    found = []
    for column, can in enumerate(reaches):
        if int(mechanism.independent[column]) in mechanism.passive_dofs:
            continue  # a rod that spins about its line changes nothing
        name = mechanism.joints[mechanism.independent[column]].name
        others = ", the other coordinates at home" if mechanism.dof > 1 else ""
        poses = thinned(swept(mechanism, can), mechanism.dof)
        found.append(measure(mechanism, poses, f"the reach of {name}{others}", coordinate=column))
    return tuple(found)


def thinned(poses: np.ndarray, dof: int) -> np.ndarray:
    """Return poses of one of `dof` paths, fewer where matrices of so many coordinates at all of them take too much room."""
    most = max(_FEWEST, _MOST_NUMBERS // dof**3)
    return poses if len(poses) <= most else poses[np.linspace(0, len(poses) - 1, most).round().astype(int)]


def swept(mechanism: Mechanism, can: Reach) -> np.ndarray:
    """Return the poses of a reach; of a joint that nothing stops, one turn, or the model's extent to either side of home."""
    if not can.turns_fully:
        return _finer(mechanism, can.poses)
    index = mechanism.independent[can.coordinate]
    travel = can.poses[:, index] - mechanism.home[index]
    if mechanism.joints[index].kind == "hinge":
        s = np.tile(mechanism.home[mechanism.independent], (_TURN_SAMPLES, 1))
        s[:, can.coordinate] += np.linspace(0.0, 2 * np.pi, _TURN_SAMPLES)
        return follow(mechanism, s)
    return _finer(mechanism, can.poses[np.abs(travel) <= (1 + 1e-9) * mechanism.extent_m])


def _finer(mechanism: Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return poses with others put in between, equally many in each gap, where they are fewer than a path's samples."""
    parts = int(np.ceil((_SAMPLES - 1) / max(1, len(poses) - 1)))
    if parts == 1:
        return poses
    places = poses[:, mechanism.independent]
    shares = np.arange(1, parts)[:, None] / parts
    gaps = [one + shares * (other - one) for one, other in pairwise(places)]
    try:
        between = follow(mechanism, np.concatenate(gaps), poses[0]).reshape(len(gaps), parts - 1, -1)
    except (AssemblyError, ValueError):  # next to a singular pose; or a reach that is a point
        between = [_followed(mechanism, gap, one) for gap, one in zip(gaps, poses, strict=False)]
    rows = [row for one, inside in zip(poses, between, strict=False) for row in (one, *inside)]
    return np.array([*rows, poses[-1]])


def _followed(mechanism: Mechanism, gap: np.ndarray, one: np.ndarray) -> np.ndarray:
    """Return the poses in a gap (n, n_s); none where it cannot be followed: the reach's own poses will do."""
    with suppress(AssemblyError):
        return follow(mechanism, gap, one)
    return np.empty((0, mechanism.n_q))


def motion_path(problem: PlanningProblem) -> KinematicLoopPath:
    """Return the report along a problem's motion before any solving: its reference, or its smooth path.

    Raises:
        ProblemError: when start, goal or reference lie outside what the mechanism reaches.
        AssemblyError: when the loops do not close along the path.
    """
    mechanism, motion = problem.mechanism, problem.motion
    guess = first_guess(problem, start_pose_of(problem))
    time = np.linspace(0.0, guess.duration_s, _SAMPLES)
    follows = motion.kind != "reach" and problem.reference is not None and not motion.waypoints
    title = f"the {'reference' if follows else 'smooth path'} of {problem.name}"
    poses = poses_along(mechanism, guess, time)
    return measure(mechanism, poses, title, time_s=time, limit=problem.limits.effort)


def inertia_notes(path: KinematicLoopPath) -> list[str]:
    """Return a sentence on the poses of a path at which the reduced inertia is singular, if there are any."""
    singular = np.flatnonzero(~is_regular(path.reduced_inertia))
    if not len(singular):
        return []
    k, joints = int(singular[0]), path.mechanism.independent_joints
    of = range(len(joints)) if path.coordinate is None else [path.coordinate]
    at = ", ".join(f"{joints[i].name} = {joints[i].said(path.positions[k, i], 4)} {joints[i].unit}" for i in of)
    return [
        f"singular inertia at {at}, in {len(singular)} of {len(path.poses)} poses along {path.title}:"
        f" {singular_inertia_text(joints, path.reduced_inertia[k])} there, and no effort fixes their acceleration"
    ]


def acts(path: KinematicLoopPath) -> np.ndarray:
    """Return whether an actuator acts on a coordinate anywhere along a path (n_s, n_u), rounding apart."""
    most = np.abs(path.ratio).max(axis=0)
    return most > _NO_ARM * most.max(axis=0, initial=0.0)


def _reflected(ratio: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Return 1 / (r_j^T M^-1 r_j) (n, n_u), infinite where r_j vanishes, not a number where M is singular."""
    regular = is_regular(inertia)
    found = np.full((len(ratio), ratio.shape[2]), np.nan)
    mobility = np.einsum("ksu,ksu->ku", ratio[regular], np.linalg.solve(inertia[regular], ratio[regular]))
    found[regular] = np.divide(1.0, mobility, out=np.full_like(mobility, np.inf), where=mobility > 0)
    return found


def _available(ratio: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Return the least and the most effort (n, n_s, 2) on each coordinate by actuators within their limits (n_u, 2)."""
    pushes = np.abs(ratio) > _NO_ARM * np.abs(ratio).max(axis=(0, 1), initial=0.0)
    found = np.zeros((*ratio.shape[:2], 2))
    for j in np.flatnonzero(pushes.any(axis=(0, 1))):
        columns = pushes[:, :, j].any(axis=0)  # the coordinates that an actuator pushes at all: few
        ends = np.multiply(ratio[:, columns, j, None], limit[j], out=np.zeros((len(ratio), columns.sum(), 2)),
                           where=pushes[:, columns, j, None])  # fmt: skip
        found[:, columns] += np.sort(ends, axis=-1)
    return found


def _singularity(mechanism: Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return the least of J_z's blocks' determinants (n,) as shares of those at home; 1 without loops."""
    if len(mechanism.dependent) == 0:
        return np.ones(len(poses))
    block = mechanism.dynamics.block_singularity
    return (sampled(block, poses)[:, :, 0] / np.array(block(mechanism.home)).ravel()).min(axis=1)


def path_record(path: KinematicLoopPath) -> dict:
    """Return what `linkplan check --json` says of a path: lists over its samples; what is infinite or no number is null."""
    mechanism = path.mechanism
    joints = list(enumerate(mechanism.joints))
    independent = [joint.name for joint in mechanism.independent_joints]
    actuators = [actuator.name for actuator in mechanism.actuators]

    def by(names: list[str], values: np.ndarray) -> dict:
        return {name: values[:, k] for k, name in enumerate(names)}

    return {
        "path": path.title,
        "coordinate": None if path.coordinate is None else independent[path.coordinate],
        "time_s": path.time_s,
        "q_deg": {joint.name: np.degrees(path.poses[:, k]) for k, joint in joints if joint.kind == "hinge"},
        "q_m": {joint.name: path.poses[:, k] for k, joint in joints if joint.kind == "slide"},
        "joint_rate": {joint.name: by(independent, path.rates[:, k]) for k, joint in joints},
        "transmission_ratio": {name: by(independent, path.ratio[:, :, j]) for j, name in enumerate(actuators)},
        "reduced_inertia": path.reduced_inertia,
        "reflected_inertia": by(actuators, path.reflected_inertia),
        "gravity_effort": by(independent, path.gravity_effort),
        "holding_effort": by(actuators, path.holding_effort),
        "unheld_effort": by(independent, path.unheld_effort),
        "available_effort": by(independent, path.available_effort),
        "singularity_ratio": path.singularity,
        "closure_force_n": by(list(mechanism.closure_names), path.closure_force),
    }
