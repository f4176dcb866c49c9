"""The closed pose nearest to a reference pose at which a loop is open. Messages offer it to users as a home pose.

Newton starts from the reference and from many poses around it. The best closed poses then move towards the reference along
the closure, q' = P (q_ref - q), where P projects onto the null space of J. The nearest pose is the result.
"""

from collections.abc import Iterator

import numpy as np

from linkplan.models.closure import newton
from linkplan.models.closure.newton import KinematicLoop
from linkplan.models.deadline import Deadline
from linkplan.models.tree.joints import POSITION_ROUNDING

# Distances of the random start poses from the reference [rad; extents on a slide].
_START_DISTANCES = (0.3, 1.0, 2.0)
# A pose is nearly singular if a singular value of its closure is below this share of the largest.
_NEARLY_SINGULAR_SHARE = 0.02


def nearest_closed_pose(loop: KinematicLoop, reference: np.ndarray) -> np.ndarray | None:
    """Return the closed pose (n_q,) found nearest to a pose, preferably regular and within the joints' ranges, or None."""
    deadline, closed = Deadline().within(2.0), []  # [s]: a model of seventy joints needs a second for a start
    for start in _starts(loop, reference):
        if closed and deadline.passed:
            break
        if (pose := _closed(loop, start)) is not None:
            closed.append(pose)
    if not closed:
        return None
    shares = [_shares(loop, pose) for pose in closed]
    largest = np.max(shares, axis=0)
    # Some singular values are small at every closed pose. At a regular pose they are not far smaller than at the others.
    least = np.where(largest > _NEARLY_SINGULAR_SHARE, _NEARLY_SINGULAR_SHARE, _NEARLY_SINGULAR_SHARE * largest)
    least[largest <= loop.rank_tolerance] = 0.0

    def regular(pose: np.ndarray) -> bool:
        return bool(np.all(_shares(loop, pose) >= least))

    def measure(pose: np.ndarray) -> tuple[bool, float, float]:
        # Mirror images are equally near: rounding does not choose between them.
        away = float(np.linalg.norm((pose - reference) / loop.unit))
        return not regular(pose), round(_outside(loop, pose), 9), round(away, 9)

    best = sorted(closed, key=measure)[: len(closed) // 4 + 1]
    deadline = Deadline().within(2.0)  # [s]
    return min((_moved_to_reference(loop, pose, reference, measure, deadline) for pose in best), key=measure)


def _starts(loop: KinematicLoop, reference: np.ndarray, n_random: int = 60) -> Iterator[np.ndarray]:
    """Yield the reference and random poses around it, the same ones in every run."""
    yield reference
    rng = np.random.default_rng(0)
    low, high = np.array([(joint.lower, joint.upper) for joint in loop.joints]).T
    for number in range(n_random):
        distance = _START_DISTANCES[number % len(_START_DISTANCES)]
        start = reference + distance * loop.unit * rng.uniform(-1.0, 1.0, len(reference))
        yield np.clip(start, low, high)


def _closed(loop: KinematicLoop, start: np.ndarray) -> np.ndarray | None:
    pose, gap = newton.close(loop, start)
    return pose if gap <= loop.closed_m else None


def _shares(loop: KinematicLoop, pose: np.ndarray) -> np.ndarray:
    """Return the singular values of the closure at a pose, as shares of the largest."""
    jacobian = loop.jacobian(pose)
    if not jacobian.size:
        return np.zeros(0)
    values = np.linalg.svd(jacobian, compute_uv=False)
    return values / max(values[0], np.finfo(float).tiny)


def _outside(loop: KinematicLoop, pose: np.ndarray) -> float:
    """Return the largest violation of a joint's range [rad or m]; 0 within rounding."""
    worst = max(max(joint.lower - x, x - joint.upper) for joint, x in zip(loop.joints, pose, strict=True))
    return max(float(worst), 0.0) if worst > POSITION_ROUNDING else 0.0


def _moved_to_reference(
    loop: KinematicLoop, pose: np.ndarray, reference: np.ndarray, measure, deadline: Deadline
) -> np.ndarray:
    """Return the closed pose reached from `pose` by steps towards the reference that each decrease `measure`."""
    step = 1.0
    for _ in range(100):
        if deadline.passed:
            break
        free = np.linalg.svd(loop.jacobian(pose))[2][loop.rank(pose) :]
        trial = _closed(loop, pose + step * loop.unit * (free.T @ (free @ ((reference - pose) / loop.unit))))
        if trial is not None and measure(trial) < measure(pose):
            pose, step = trial, min(1.0, 2 * step)
        elif step > 1e-3:
            step *= 0.5
        else:
            break
    return pose
