"""The closed pose nearest to one at which a loop stands open: what to write into a model or a problem so that it assembles.

Newton is begun from the reference and from many poses about it; of the closed poses that it comes to, each is led back
towards the reference along the closure, q' = P (q_ref - q), P onto the null space of J, and the nearest is kept.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from linkplan.models.closure import newton
from linkplan.models.closure.newton import KinematicLoop
from linkplan.models.tree.joints import Joint

# Poses that Newton is begun from, and how far about the reference [rad; on a slide, of the model's extent].
_STARTS, _ABOUT = 60, (0.3, 1.0, 2.0)
# Steps back towards the reference, and the shortest that is still taken, of the whole way.
_STEPS, _LEAST_STEP = 100, 1e-3
# A pose whose closure has a singular value below this share of the largest is next to a singular one: no place to begin.
_SINGULAR = 0.02
# A joint may stand outside its range by this [rad or m]: rounding.
_OUTSIDE = 1e-9


def nearest_closed_pose(
    loop: KinematicLoop, joints: Sequence[Joint], reference: np.ndarray, unit: np.ndarray
) -> np.ndarray | None:
    """Return the closed pose (n_q,) found nearest to a reference, in the joints' ranges and off singular poses if it can be.

    Args:
        loop: the closure.
        joints: with their ranges.
        reference: the pose (n_q,) to be near.
        unit: what counts as a radian for each joint (n_q,) [rad or m].
    """
    closed = [pose for start in _starts(joints, reference, unit) if (pose := _closed(loop, start)) is not None]
    if not closed:
        return None
    shares = [_shares(loop, pose, unit) for pose in closed]
    rank = max(int(np.sum(values > _SINGULAR)) for values in shares)

    def regular(pose: np.ndarray) -> bool:
        return rank == 0 or int(np.sum(_shares(loop, pose, unit) > _SINGULAR)) >= rank

    def measure(pose: np.ndarray) -> tuple[bool, float, float]:
        return not regular(pose), round(_outside(joints, pose), 9), float(np.linalg.norm((pose - reference) / unit))

    best = sorted(closed, key=measure)[: len(closed) // 4 + 1]
    return min((_led_back(loop, pose, reference, unit, measure) for pose in best), key=measure)


def _starts(joints: Sequence[Joint], reference: np.ndarray, unit: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the reference, and poses about it near and far, the same in every run."""
    yield reference
    rng = np.random.default_rng(0)
    low = np.array([joint.lower for joint in joints])
    high = np.array([joint.upper for joint in joints])
    for number in range(_STARTS):
        start = reference + _ABOUT[number % len(_ABOUT)] * unit * rng.uniform(-1.0, 1.0, len(reference))
        yield np.clip(start, low, high)


def _closed(loop: KinematicLoop, start: np.ndarray) -> np.ndarray | None:
    pose, gap = newton.close(loop, start, list(range(len(start))))
    return pose if gap <= loop.closed_m else None


def _shares(loop: KinematicLoop, pose: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Return the singular values of the closure at a pose, as shares of the largest."""
    jacobian = loop.residual(pose)[1] * unit
    if not jacobian.size:
        return np.zeros(0)
    values = np.linalg.svd(jacobian, compute_uv=False)
    return values / max(values[0], np.finfo(float).tiny)


def _outside(joints: Sequence[Joint], pose: np.ndarray) -> float:
    """Return by how much joints stand outside their ranges [rad or m], the worst of them; 0 within rounding."""
    worst = max(max(joint.lower - x, x - joint.upper) for joint, x in zip(joints, pose, strict=True))
    return max(float(worst), 0.0) if worst > _OUTSIDE else 0.0


def _led_back(loop: KinematicLoop, pose: np.ndarray, reference: np.ndarray, unit: np.ndarray, measure) -> np.ndarray:
    """Return the pose that a closed one is led to towards the reference, as long as that makes `measure` less."""
    step = 1.0
    for _ in range(_STEPS):
        jacobian = loop.residual(pose)[1] * unit
        right = np.linalg.svd(jacobian)[2]
        free = right[int(np.sum(_shares(loop, pose, unit) > loop.rank_tolerance)) :]
        trial = _closed(loop, pose + step * unit * (free.T @ (free @ ((reference - pose) / unit))))
        if trial is not None and measure(trial) < measure(pose):
            pose, step = trial, min(1.0, 2 * step)
        elif step > _LEAST_STEP:
            step *= 0.5
        else:
            break
    return pose
