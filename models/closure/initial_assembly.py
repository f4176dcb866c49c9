"""Initial assembly: the home pose near a reference pose, closed poses near home, and the check for a singular home."""

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import replace
from random import Random

import numpy as np

from linkplan.models.closure import newton
from linkplan.models.closure.newton import KinematicLoop
from linkplan.models.errors import AssemblyError, LockedError, ModelError, UnassembledError
from linkplan.models.tree.joints import index_of, where

# Largest distance [rad or m] between a dependent joint's position in `home` and its closed position on the same branch.
HOME_TOLERANCE = np.radians(5.0)

# Steps that test whether a joint can move from home [rad; extents on a slide]. The short one serves next to an end of reach.
_HOME_STEPS = (0.02, 0.002)
# Distance of the sampled nearby poses from home [rad; extents on a slide].
_NEARBY_STEP = 0.15


def home_positions(loop: KinematicLoop, home: Mapping[str, float] | None) -> dict[int, float]:
    """Return the positions [rad or m] in `home` by joint index."""
    asked = {index_of(loop.name, loop.joints, joint): float(value) for joint, value in (home or {}).items()}
    for index, value in asked.items():
        if not abs(value) < 1000:  # Newton would take steps without end
            raise ModelError(f"home of joint '{loop.joints[index].name}' is within 1000 rad or m, got {value!r}")
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
            f"mechanism '{loop.name}' assembles with {violation}; give the model a keyframe 'home' near the pose meant"
        )
    return pose


def _assemble(loop: KinematicLoop, reference: np.ndarray, asked: dict[int, float], *, measured: bool) -> np.ndarray:
    """Return a closed pose, or raise an error with the gap, which is the least one if it is `measured`."""
    everything = list(range(len(loop.joints)))
    near, gap = newton.close(loop, reference)
    if not asked:
        if gap > loop.closed_m:
            gap = min(gap, newton.least_gap(loop, near, everything)) if measured else gap
            raise UnassembledError(
                f"mechanism '{loop.name}' does not close from its reference pose: the loop stays open by {1e3 * gap:.3g} mm",
                gap,
            )
        return near
    base = near if gap <= loop.closed_m else reference
    start = np.array([asked.get(i, base[i]) for i in everything])
    unnamed = [i for i in everything if i not in asked]
    # Unnamed joints may belong to another branch than the reference's: quarter turns of them are further starts.
    starts = [start, *(_turned(loop, start, unnamed) if len(asked) > 1 else [])]
    from_reference = [newton.follow(loop, near, asked)] if gap <= loop.closed_m else []
    for pose, gap in itertools.chain(from_reference, _trial_poses(loop, starts, list(asked), unnamed)):
        away = max(abs(pose[i] - value) for i, value in asked.items())
        if gap <= loop.closed_m and away <= HOME_TOLERANCE:
            return pose
    gap = min(newton.least_gap(loop, trial, unnamed) for trial in starts) if measured else np.inf
    raise AssemblyError(
        f"mechanism '{loop.name}' does not close at {where(loop.joints, asked)}: the loop stays open by {1e3 * gap:.3g} mm"
    )


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


def _turned(loop: KinematicLoop, start: np.ndarray, unnamed: list[int]) -> list[np.ndarray]:
    """Return `start` with all unnamed hinges turned by one, two and three quarter turns, as starts on other branches."""
    hinges = [i for i in unnamed if loop.joints[i].kind == "hinge" and loop.joints[i].chart is None]
    turned = []
    for quarter in (1, 2, 3) if hinges else ():
        trial = np.array(start)
        trial[hinges] += quarter * np.pi / 2
        turned.append(trial)
    return turned


def nearby_poses(loop: KinematicLoop, home: np.ndarray, n_poses: int = 4) -> list[np.ndarray]:
    """Return closed poses near a closed home pose (n_q,), in random directions that the loops leave free there."""
    jacobian = loop.jacobian(home)
    free = np.linalg.svd(jacobian)[2][loop.rank(home) :].T if jacobian.size else np.eye(len(home))
    random = Random(0)  # the standard library's generator: numpy's takes as long to load as the assembly takes
    found = []
    for _ in range(n_poses if free.shape[1] else 0):
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
    rest = [i for i in range(len(loop.joints)) if i not in held]
    # The rank is checked first: where several loops lie flat at once, a joint that cannot move alone is no sign of a lock.
    away = [q for q in about if np.abs((q - pose) / loop.unit).max() > 0.5 * _NEARBY_STEP]
    _refuse_lower_rank(loop, rank, away)
    neighbours = list(about)
    for index in held:
        moved = False
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
