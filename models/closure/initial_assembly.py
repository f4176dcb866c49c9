"""Initial assembly: the home pose near a reference pose, closed poses near home, and the check for a singular home.

A model whose loops are open at its own pose gets the nearest closed pose as text: a keyframe, or keys of [mechanism].

Anchors in a file may lie beside their hinge's axis, which leaves a gap that no joint can change. It is the part of phi in
the directions that no joint moves, the left null space of J at all poses together. In a planar loop this is the offset of
the two anchors along the hinges' common axis. A shift of one anchor along the axis closes it and changes no motion.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from random import Random

import mujoco
import numpy as np

from linkplan.models.closure import newton
from linkplan.models.closure.equations import Closure, earlier_pin
from linkplan.models.closure.mobility import Mobility, judge_mobility, locked_by
from linkplan.models.closure.newton import KinematicLoop, nearest_closed_pose
from linkplan.models.closure.rank import FILE_ROUNDING_SHARE, ROUNDING_SHARE, blocks
from linkplan.models.errors import AssemblyError, LockedError, ModelError, UnassembledError
from linkplan.models.kinematics import data_at, tied_points
from linkplan.models.reading import key_text
from linkplan.models.tree.coordinates import Coordinates
from linkplan.models.tree.joints import Joint, index_of, where

# The largest shift without a tolerance of the user's, as a share of the mechanism's size.
SHIFT_SHARE = 0.05
# Shifts [m] below this one are rounding of the arithmetic.
_LEAST_SHIFT_M = 1e-13
# Directions whose rate of change by any joint is below this share of the largest do not move: axes of rounded files are
# parallel to about 1e-6 rad.
_STILL_SHARE = 1e-5
# Poses about the reference at which J is taken, and their distance from it [rad; extents on a slide].
_NEARBY_POSES, _POSE_DISTANCE = 6, 0.2
# Decimals of an angle [deg] in a problem file; assembly removes the rounding. Lengths [m] have three more.
_ANGLE_DECIMALS = 6
# Significant digits of a keyframe: its loops then close to a nanometre without assembly.
_KEYFRAME_DIGITS = 10
# Largest distance [rad or m] between a dependent joint's position in `home` and its closed position on the same branch.
HOME_TOLERANCE = np.radians(5.0)
# Steps that test whether a joint can move from home [rad; extents on a slide]. The short one serves next to an end of reach.
_HOME_STEPS = (0.02, 0.002)
# Distance of the sampled nearby poses from home [rad; extents on a slide].
_NEARBY_STEP = 0.15
# Their number.
_NEARBY_HOME = 4


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Shift:
    """A shift (3,) [m] of the end (0 or 1) of a closure's anchor, in its body's frame. `index` is the equality's."""

    index: int
    name: str
    end: int
    by: np.ndarray

    @property
    def sentence(self) -> str:
        """The sentence that names the anchor and the length of its shift."""
        length = 1e3 * float(np.linalg.norm(self.by))
        return f"anchor of closure {self.name} moved by {length:.3g} mm along its hinge's axis, where no joint can close it"


def removable_gaps(loop: KinematicLoop, reference: np.ndarray) -> np.ndarray:
    """Return the part (n_rows,) [m] of the gaps at the reference pose that no joint can change; zero in rows of angles."""
    phi, _ = loop.residual(reference)
    rng = Random(0)  # numpy.random takes long to load
    steps = [np.array([rng.uniform(-_POSE_DISTANCE, _POSE_DISTANCE) for _ in reference]) for _ in range(_NEARBY_POSES)]
    poses = [reference, *(reference + step * loop.unit for step in steps)]
    still, jacobians = np.zeros_like(phi), [loop.jacobian(q) for q in poses]
    for closure in loop.closures:
        if closure.kind != "point" or closure.rows.stop - closure.rows.start != 3:
            continue
        rates = np.hstack([jacobian[closure.rows] for jacobian in jacobians])
        left, size, _ = np.linalg.svd(np.linalg.qr(rates.T, mode="r").T)
        directions = left[:, size <= _STILL_SHARE * size[0]]
        still[closure.rows] = directions @ (directions.T @ phi[closure.rows])
    return still


def shifts(
    model: mujoco.MjModel, closures: Sequence[Closure], still: np.ndarray, qpos: np.ndarray, limit_m: float
) -> list[Shift]:
    """Return the shifts of anchors that close gaps `still` (n_rows,) [m] of at most `limit_m`.

    Args:
        model: with the anchors.
        closures: of the model.
        still: see `removable_gaps`.
        qpos: MuJoCo's reference pose (nq,).
        limit_m: larger gaps are left.
    """
    data = data_at(model, qpos)
    found = []
    for closure in closures:
        gap = still[closure.rows]
        if not _LEAST_SHIFT_M < np.linalg.norm(gap) <= limit_m or earlier_pin(model, closure.index) is not None:
            continue
        in_world = data.xmat[closure.frame].reshape(3, 3) @ gap
        ends = tied_points(model, closure.index)
        end = 1 if ends[1][0] else 0  # the world's own anchors stay
        by = data.xmat[ends[end][0]].reshape(3, 3).T @ (in_world if end else -in_world)
        found.append(Shift(index=closure.index, name=closure.name, end=end, by=by))
    return found


def refuse_large_gaps(loop: KinematicLoop, still: np.ndarray, limit_m: float) -> None:
    """Refuse gaps along a hinge's axis of more than `limit_m`, and name the tolerance that accepts them.

    Raises:
        UnassembledError: for the largest of them.
    """
    gaps = {closure.name: float(np.linalg.norm(still[closure.rows])) for closure in loop.closures}
    widest = max(gaps, key=gaps.__getitem__, default="")
    if widest and gaps[widest] > limit_m:
        raise UnassembledError(
            f"mechanism '{loop.name}' does not close: closure {widest} is open by {1e3 * gaps[widest]:.4g} mm along its"
            " hinge's axis, which no joint can change; mechanism.closure_tolerance_m ="
            f" {1.01 * gaps[widest]:.3g} moves its anchor",
            gaps[widest],
        )


def apply_shifts(model: mujoco.MjModel, found: Sequence[Shift]) -> None:
    """Move the anchors of a compiled model."""
    for shift in found:
        _, point = tied_points(model, shift.index)[shift.end]
        point += shift.by


def keyframe_of(coordinates: Coordinates, pose: np.ndarray) -> str:
    """Return the MJCF keyframe "home" of a pose (n_q,)."""
    qpos = np.where(np.abs(values := coordinates.qpos_of(pose)) < 10.0**-_KEYFRAME_DIGITS, 0.0, values)
    return f'<keyframe><key name="home" qpos="{" ".join(f"{x:.{_KEYFRAME_DIGITS}g}" for x in qpos)}"/></keyframe>'


def home_of(joints: Sequence[Joint], pose: Sequence[float] | np.ndarray) -> dict[str, dict[str, float]]:
    """Return the tables home_deg and home_m of joints at positions [rad or m], without empty ones."""
    tables: dict[str, dict[str, float]] = {}
    for joint, x in zip(joints, pose, strict=True):
        decimals = _ANGLE_DECIMALS if joint.kind == "hinge" else _ANGLE_DECIMALS + 3
        tables.setdefault(f"home_{joint.unit}", {})[joint.name] = round(joint.shown(x), decimals) + 0.0
    return tables


def home_text(tables: dict[str, dict[str, float]]) -> str:
    """Return home_deg and home_m, or other tables by joint, as lines of a problem file's [mechanism] table."""
    rows = []
    for key, table in tables.items():
        values = ", ".join(f"{key_text(joint)} = {x:.10g}" for joint, x in table.items())
        rows.append(f"{key} = {{ {values} }}")
    return "\n".join(rows)


def idle_drives(joints, actuators, dynamics, poses, mobility: Mobility, extent_m: float) -> tuple[list[str], list[str]]:
    """Return notes on the actuators that the loops leave without effect at closed poses (n_q,), and faults.

    It is a fault if a closure tolerance frees the actuator's target, with a gap that rounding may leave in a mechanism of
    the size `extent_m`.
    """
    maps = [np.array(dynamics.effort_map(q)).reshape(dynamics.effort_map.size1_out(0), -1) for q in poses]
    full = [np.array(dynamics.effort_matrix(q)).reshape(len(joints), -1) for q in poses]
    moves, arms = (np.array([np.abs(one).max(axis=0) for one in matrices]) for matrices in (maps, full))
    idle = np.flatnonzero(np.all(moves <= ROUNDING_SHARE * np.maximum(arms, ROUNDING_SHARE), axis=0)).tolist()
    notes, faults = [], []
    for j, tolerance in zip(idle, _freeing_tolerances(mobility, poses[0], full[0][:, idle], extent_m), strict=True):
        said = f"actuator {actuators[j].name} has no effect: the loops lock {actuators[j].target}"
        freeing = f"its motion opens them by {(tolerance or 0) / 1.01:.2g} m, which mechanism.closure_tolerance_m ="
        (notes if tolerance is None else faults).append(
            said if tolerance is None else f"{said}; {freeing} {tolerance:.3g} allows"
        )
    return notes, faults


def _freeing_tolerances(mobility: Mobility, pose: np.ndarray, arms: np.ndarray, extent_m: float) -> list[float | None]:
    """Return the closure tolerance [m] that frees the target of each of some actuators at a closed pose (n_q,), or None.

    `arms` (n_q, n) are their efforts on the coordinates. Only gaps that rounding may leave in a mechanism of the size
    `extent_m` are tried, from the smallest on; a freedom that ends next to the pose is none.
    """
    found: list[float | None] = [None] * arms.shape[1]
    freed_m = judge_mobility(mobility.loop, pose, 0.1 * SHIFT_SHARE * extent_m).freed_m if found else ()
    for gap in np.maximum.accumulate(freed_m[len(mobility.freed_m) :]):
        if None not in found:
            break
        loop = judge_mobility(mobility.loop, pose, 1.01 * float(gap)).loop
        rank = loop.rank(pose)
        if any(loop.rank(q) != rank for q in nearby_poses(loop, pose)):
            continue
        kernel = np.linalg.svd(loop.jacobian(pose))[2][rank:]
        moved = np.abs(kernel @ arms).max(axis=0, initial=0.0) > FILE_ROUNDING_SHARE * np.abs(arms).max(axis=0)
        found = [1.01 * float(gap) if moves and one is None else one for one, moves in zip(found, moved, strict=True)]
    return found


def with_closed_pose(
    error: UnassembledError, loop: KinematicLoop, reference: np.ndarray, extent_m: float
) -> UnassembledError:
    """Return an error that offers the closed pose nearest to `reference` (n_q,), or states why there is none to offer.

    A tolerance is offered only for a gap that rounding may leave in a mechanism of the size `extent_m`.
    """
    if error.home:
        return error
    pose = nearest_closed_pose(loop, reference)
    if pose is not None:
        return _offering(error, loop, pose)
    tolerance = f", or rounded, which mechanism.closure_tolerance_m = {1.01 * error.gap_m:.3g} accepts"
    hint = f"the links may be too short{tolerance if error.gap_m <= 0.1 * SHIFT_SHARE * extent_m else ''}"
    return UnassembledError(
        f"{error}; no closed pose was found near it: {hint}; otherwise name a pose with mechanism.home_deg", error.gap_m
    )


def _offering(error: UnassembledError, loop: KinematicLoop, pose: np.ndarray) -> UnassembledError:
    home = home_of(loop.joints, pose)
    if loop.rank(pose) == len(loop.joints):
        hint = "at the nearest closed pose found, the loops lock every joint"
        return UnassembledError(f"{error}; {hint}: {'; '.join(home_text(home).splitlines())}", error.gap_m)
    hint = f"nearest closed pose found: mechanism.{' and mechanism.'.join(home_text(home).splitlines())}"
    return UnassembledError(f"{error}; {hint}", error.gap_m, keyframe_of(loop.coordinates, pose), home)


def locked_or_singular(error: LockedError, loop: KinematicLoop, pose: np.ndarray) -> AssemblyError:
    """Return the error for a pose (n_q,) at which a joint cannot move.

    At a singular pose (a flat parallelogram) the error offers a regular closed pose. Otherwise the mechanism is locked (a
    flat truss) and the error names the closures that lock it.
    """
    other = nearest_closed_pose(loop, pose)
    if other is not None and loop.rank(pose) < loop.rank(other) < len(loop.joints):
        return _offering(UnassembledError(str(error)), loop, other)
    return locked_by(error, loop, pose)


def home_positions(loop: KinematicLoop, home: Mapping[str, float] | None) -> dict[int, float]:
    """Return the positions [rad or m] in `home` by joint index."""
    asked = {index_of(loop.name, loop.joints, joint): float(value) for joint, value in (home or {}).items()}
    for index, value in asked.items():
        if not abs(value) < 1000:  # Newton's steps would never end
            raise ModelError(f"home of joint '{loop.joints[index].name}' must be within 1000 rad or m, got {value!r}")
    return asked


def assemble(loop: KinematicLoop, reference: np.ndarray, asked: dict[int, float], tolerance_m: float) -> np.ndarray:
    """Return a pose that closes every loop, with the asked joints at their values as far as the loops allow.

    The asked joints first move on a straight line from the closed reference pose, which keeps the reference's branch. If a
    loop opens on the way, Newton starts from the asked values, which then choose the branch. If no pose closes to
    rounding, a gap up to `tolerance_m` [m] is accepted (the points of the file may be rounded).

    Raises:
        AssemblyError: if no closed pose is found, or if a ball joint leaves its chart.
    """
    last = tolerance_m <= loop.closed_m
    try:
        pose = _assemble(loop, reference, asked, measured=last)
    except AssemblyError:
        if last:
            raise
        pose = _assemble(replace(loop, closed_m=tolerance_m), reference, asked, measured=True)
    violation = loop.coordinates.range_violation(pose)
    if violation is not None:
        raise AssemblyError(
            f"mechanism '{loop.name}' assembles with {violation}; give the model a keyframe 'home' near the intended pose"
        )
    return pose


def _assemble(loop: KinematicLoop, reference: np.ndarray, asked: dict[int, float], *, measured: bool) -> np.ndarray:
    """Return a closed pose, or raise an error with the gap, which is the least one if it is `measured`."""
    everything = list(range(len(loop.joints)))
    near, gap = newton.close(loop, reference)
    if not asked:
        if gap > loop.closed_m:
            gap, name = min((gap, ""), newton.least_gap(loop, near, everything)) if measured else (gap, "")
            where_open = f" at closure {name}" if name and len(loop.closures) > 1 else ""
            raise UnassembledError(
                f"mechanism '{loop.name}' does not close from its reference pose: the loop stays open by {1e3 * gap:.3g} mm"
                + where_open,
                gap,
            )
        return newton.within_ranges(loop, reference, near)
    base = near if gap <= loop.closed_m else reference
    start = np.array([asked.get(i, base[i]) for i in everything])
    unnamed = [i for i in everything if i not in asked]
    # Unnamed joints may belong to another branch than the reference's: quarter turns of them are further starts.
    hinges = [i for i in unnamed if loop.joints[i].kind == "hinge" and loop.joints[i].chart is None]
    starts = [start]
    for quarter in (1, 2, 3) if hinges and len(asked) > 1 else ():
        starts.append(np.array(start))
        starts[-1][hinges] += quarter * np.pi / 2
    from_reference = [newton.follow(loop, near, asked)] if gap <= loop.closed_m else []
    nearest, least = None, np.inf
    for pose, gap in itertools.chain(from_reference, _trial_poses(loop, starts, list(asked), unnamed)):
        away = max(abs(pose[i] - value) for i, value in asked.items())
        if gap <= loop.closed_m and away <= HOME_TOLERANCE:
            return pose
        if gap <= loop.closed_m and away < least:
            nearest, least = pose, away
    gap = min(newton.least_gap(loop, trial, unnamed)[0] for trial in starts) if measured else np.inf
    at = where([loop.joints[i] for i in asked], asked.values(), 6)
    error = UnassembledError(
        f"mechanism '{loop.name}' does not close at {at}: the loop stays open by {1e3 * gap:.3g} mm", gap
    )
    if nearest is None:
        raise error
    turns = np.array([joint.kind == "hinge" and joint.chart is None for joint in loop.joints])
    raise _offering(error, loop, nearest - 2 * np.pi * np.round((nearest - start) / (2 * np.pi)) * turns)


def _trial_poses(
    loop: KinematicLoop, starts: list[np.ndarray], asked: list[int], unnamed: list[int]
) -> Iterator[tuple[np.ndarray, float]]:
    """Yield poses and their gaps by Newton from `starts`, with fewer and fewer of the asked joints held.

    More joints may be asked than the loop leaves free. The first are then held, and the others only choose the branch.
    """
    for n_held in range(len(asked), 0, -1):
        free = [i for i in range(len(starts[0])) if i not in asked[:n_held]]
        for trial in starts:
            guess = newton.close(loop, trial, unnamed)[0] if n_held < len(asked) and unnamed else trial
            yield newton.close(loop, guess, free)


def nearby_poses(loop: KinematicLoop, home: np.ndarray) -> list[np.ndarray]:
    """Return closed poses near a closed home pose (n_q,), in random directions that the loops leave free there."""
    jacobian = loop.jacobian(home)
    free = np.linalg.svd(jacobian)[2][loop.rank(home) :].T if jacobian.size else np.eye(len(home))
    random = Random(0)  # the standard library's generator: numpy's takes as long to load as the assembly takes
    found = []
    for _ in range(_NEARBY_HOME if free.shape[1] else 0):
        direction = free @ [random.gauss(0.0, 1.0) for _ in range(free.shape[1])]
        trial = home + _NEARBY_STEP * loop.unit * direction / np.abs(direction).max()
        pose, gap = newton.close(loop, trial)
        if gap <= loop.closed_m:
            found.append(pose)
    return found


def refuse_singular_assembly(
    loop: KinematicLoop, pose: np.ndarray, independent: np.ndarray, about: list[np.ndarray]
) -> None:
    """Refuse a home pose at which an independent joint cannot move, or whose closure rank is below the rank nearby.

    A parallelogram drawn flat, or a truss of three bars in a line, has fewer independent rows there than elsewhere.

    Args:
        loop: the closure.
        pose: its home (n_q,).
        independent: indices of the independent joints.
        about: further closed poses.

    Raises:
        LockedError: if an independent joint cannot move.
        UnassembledError: if the pose is singular.
    """
    rank, held = loop.rank(pose), independent.tolist()
    tied = blocks(loop.pattern)
    # The rank is checked first: where several loops lie flat at once, a joint that cannot move alone is no sign of a lock.
    away = [q for q in about if np.abs((q - pose) / loop.unit).max() > 0.5 * _NEARBY_STEP]
    _refuse_lower_rank(loop, rank, away)
    neighbours = list(about)
    for index in held:
        moved, rest = False, [int(i) for _, joints in tied if index in joints for i in joints if i not in held]
        for step in _HOME_STEPS:
            for change in (step, -step):
                trial = np.array(pose)
                trial[index] += change * loop.unit[index]
                neighbour, gap = newton.close(loop, trial, rest)
                if gap <= loop.closed_m:
                    moved = True
                    neighbours.append(neighbour)
            if moved:
                break
        if not moved and rank:
            raise LockedError(
                f"mechanism '{loop.name}' cannot move joint {loop.joints[index].name} from its home pose: the loop is"
                " singular or locked there; name another pose with mechanism.home_deg"
            )
    _refuse_lower_rank(loop, rank, neighbours)


def _refuse_lower_rank(loop: KinematicLoop, rank: int, neighbours: list[np.ndarray]) -> None:
    there = max(map(loop.rank, neighbours), default=rank)
    if there != rank:
        raise UnassembledError(
            f"mechanism '{loop.name}' is assembled in a singular pose: its closure has rank {rank} there and {there} next"
            " to it; name another pose with mechanism.home_deg"
        )
