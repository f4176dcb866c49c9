"""Initial assembly: the home pose near a reference, the poses about it, and the refusal of a singular one."""

import numbers
from collections.abc import Mapping
from dataclasses import replace
from random import Random

import numpy as np

from linkplan.models.closure import newton
from linkplan.models.closure.newton import KinematicLoop
from linkplan.models.closure.rank import numerical_rank
from linkplan.models.errors import AssemblyError, LockedError, ModelError, UnassembledError
from linkplan.models.tree.joints import Joint, index_of, where

# Joint angles named in `home` beside the independent ones choose a branch; the loop may settle this far from them.
HOME_TOLERANCE = np.radians(5.0)
# No joint is asked to stand further out than this [rad or m].
_FARTHEST = 1e3
# Steps from the home pose that test whether it is a regular one [rad; on a slide, of the model's extent]: the shorter where
# the longer opens the loop, next to an end of the reach.
_HOME_STEPS = (0.02, 0.002)
# Poses sampled about home, and how far away they are [rad; on a slide, of the model's extent].
_NEARBY = 4
_NEARBY_STEP = 0.15


def home_positions(name: str, joints: tuple[Joint, ...], home: Mapping[str, float] | None) -> dict[int, float]:
    """Return the positions [rad or m] that `home` asks for, by joint index."""
    asked = {}
    for joint, value in (home or {}).items():
        index = index_of(name, joints, joint)
        number = isinstance(value, numbers.Real) and not isinstance(value, bool)
        if not number or not abs(value) < _FARTHEST:
            raise ModelError(f"home of joint '{joint}' is a finite position within {_FARTHEST:g} rad or m, got {value!r}")
        asked[index] = float(value)
    return asked


def assemble(
    name: str,
    joints: tuple[Joint, ...],
    loop: KinematicLoop,
    reference: np.ndarray,
    asked: dict[int, float],
    tolerance_m: float = newton.CLOSED_M,
) -> np.ndarray:
    """Return a pose that closes every loop, with the asked joints held as far as the loops leave them free.

    From the reference pose along a straight line to the asked one where that closes, which stays on the reference's
    branch; else by Newton from the asked values, which then choose the branch. Where nothing closes to rounding, a gap
    within `tolerance_m` [m] will do: that of a file whose points are rounded.
    """
    try:
        return _assemble(name, joints, loop, reference, asked)
    except AssemblyError:
        if tolerance_m <= loop.closed_m:
            raise
        return _assemble(name, joints, replace(loop, closed_m=tolerance_m), reference, asked)


def _assemble(
    name: str, joints: tuple[Joint, ...], loop: KinematicLoop, reference: np.ndarray, asked: dict[int, float]
) -> np.ndarray:
    everything = list(range(len(joints)))
    near, gap = newton.close(loop, reference, everything)
    if not asked:
        if gap > loop.closed_m:
            gap = min(gap, newton.least_gap(loop, near, everything))
            raise UnassembledError(
                f"mechanism '{name}' does not close from its reference pose: the loop stays open by {1e3 * gap:.3g} mm",
                gap,
            )
        return near
    base = near if gap <= loop.closed_m else reference
    start = np.array([asked.get(i, base[i]) for i in everything])
    unnamed = [i for i in everything if i not in asked]
    poses = []
    if gap <= loop.closed_m:
        poses.append(newton.follow(loop, near, asked))
    # Where more joints are named than the loop leaves free, the first are held and the others choose the branch. Unnamed
    # joints may start on another branch than the reference's: each is tried all round as well.
    starts = [start, *(_turned(joints, start, unnamed) if len(asked) > 1 else [])]
    for n_held in range(len(asked), 0, -1):
        held = list(asked)[:n_held]
        free = [i for i in everything if i not in held]
        for trial in starts:
            guess = newton.close(loop, trial, unnamed)[0] if n_held < len(asked) and unnamed else trial
            poses.append(newton.close(loop, guess, free))
            for pose, open_by in poses:
                away = max(abs(pose[i] - value) for i, value in asked.items())
                if open_by <= loop.closed_m and away <= HOME_TOLERANCE:
                    return pose
            poses.clear()
    gap = min(newton.least_gap(loop, trial, unnamed) for trial in starts)
    raise AssemblyError(
        f"mechanism '{name}' does not close at {where(joints, asked)}: the loop stays open by {1e3 * gap:.3g} mm"
    )


def _turned(joints, start: np.ndarray, unnamed: list[int]) -> list[np.ndarray]:
    """Return `start` with its unnamed hinges turned by quarters, together: places to look for another branch from."""
    hinges = [i for i in unnamed if joints[i].kind == "hinge" and joints[i].chart is None]
    turned = []
    for quarter in (1, 2, 3) if hinges else ():
        trial = np.array(start)
        trial[hinges] += quarter * np.pi / 2
        turned.append(trial)
    return turned


def poses_about(loop: KinematicLoop, home: np.ndarray, unit: np.ndarray) -> list[np.ndarray]:
    """Return closed poses some way off the home pose, in directions that the loops leave free there.

    Args:
        loop: the closure.
        home: a closed pose (n_q,).
        unit: what counts as a radian for each joint (n_q,) [rad or m].
    """
    jacobian = loop.residual(home)[1] * unit
    rank = numerical_rank(jacobian, loop.rank_tolerance)
    free = np.linalg.svd(jacobian)[2][rank:].T if jacobian.size else np.eye(len(home))
    random = Random(0)  # the standard library's: numpy's takes as long to load as a loop to close
    found = []
    for _ in range(_NEARBY if free.shape[1] else 0):
        direction = free @ [random.gauss(0.0, 1.0) for _ in range(free.shape[1])]
        trial = home + _NEARBY_STEP * unit * direction / np.abs(direction).max()
        pose, gap = newton.close(loop, trial, list(range(len(home))))
        if gap <= loop.closed_m:
            found.append(pose)
    return found


def refuse_singular_assembly(
    name: str,
    joints: tuple[Joint, ...],
    loop: KinematicLoop,
    pose: np.ndarray,
    independent: np.ndarray,
    extent: float,
    about: list[np.ndarray],
) -> None:
    """Refuse a home pose where the rank is not that of its neighbours, or from which nothing can move.

    A parallelogram drawn flat, or a truss of three bars in a line, shows fewer independent rows there than it has.

    Args:
        name: of the mechanism.
        joints: of the mechanism.
        loop: its closure.
        pose: its home (n_q,).
        independent: indices of the independent joints.
        extent: of what moves [m].
        about: further closed poses.

    Raises:
        LockedError: where an independent joint cannot move.
        UnassembledError: where the pose is singular.
    """
    unit = np.array([1.0 if joint.kind == "hinge" else extent for joint in joints])
    rank = numerical_rank(loop.residual(pose)[1] * unit, loop.rank_tolerance)
    held = [int(i) for i in independent]
    rest = [i for i in range(len(joints)) if i not in held]
    # Where several loops lie flat at once, motions are free to first order that no pose nearby has: what cannot move alone
    # there says less than the rank.
    away = [q for q in about if np.abs((q - pose) / unit).max() > 0.5 * _NEARBY_STEP]
    _refuse_lower_rank(name, loop, rank, away, unit)
    neighbours = list(about)
    for index in held:
        moved = False
        for step in _HOME_STEPS:
            for change in (step, -step):
                trial = np.array(pose)
                trial[index] += change * (1.0 if joints[index].kind == "hinge" else extent)
                neighbour, gap = newton.close(loop, trial, rest)
                if gap <= loop.closed_m:
                    moved = True
                    neighbours.append(neighbour)
            if moved:
                break
        if not moved and rank:
            raise LockedError(
                f"mechanism '{name}' cannot move joint {joints[index].name} from its home pose: the loop is singular or"
                " locked there; name another pose with mechanism.home_deg",
                {},
            )
    _refuse_lower_rank(name, loop, rank, neighbours, unit)


def _refuse_lower_rank(name: str, loop: KinematicLoop, rank: int, neighbours: list[np.ndarray], unit: np.ndarray) -> None:
    there = max(
        (numerical_rank(loop.residual(neighbour)[1] * unit, loop.rank_tolerance) for neighbour in neighbours), default=rank
    )
    if there != rank:
        raise UnassembledError(
            f"mechanism '{name}' is assembled in a singular pose: its closure has rank {rank} there and {there} next"
            " to it; name another pose with mechanism.home_deg"
        )
