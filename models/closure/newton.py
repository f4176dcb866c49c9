"""Closing loops numerically: a damped Gauss-Newton on phi(q) = 0 from a nearby pose."""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.models.closure.rank import RANK_TOLERANCE

# Largest gap [m] of a closed loop: a hundredth of the 1e-9 m that certificates promise, and far above rounding.
CLOSED_M = 1e-11

# Longest step of a joint [rad or m]: short enough for Newton to stay on its branch.
_MAX_STEP = 0.3
# Newton ignores singular values of J below this share of the largest.
_LEAST_SINGULAR_SHARE = 1e-10


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class KinematicLoop:
    """The closure as numbers: `function` maps q to phi [m] and J, and each slice of `rows` is one gap.

    A loop counts as closed below the gap `closed_m` [m]. Singular values below `rank_tolerance` times the largest count as
    zero. Both tolerances are larger for a file with rounded numbers, see `closure.mobility`.
    """

    function: ca.Function
    rows: tuple[slice, ...]
    closed_m: float = CLOSED_M
    rank_tolerance: float = RANK_TOLERANCE

    def residual(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return phi (n_rows,) [m] and its Jacobian (n_rows, n_q)."""
        phi, jacobian = self.function(q)
        return np.array(phi).ravel(), np.array(jacobian).reshape(-1, len(q))

    def gap(self, phi: np.ndarray) -> float:
        """Return the largest gap [m] in values of phi; an angle counts with its lever."""
        return max((float(np.linalg.norm(phi[rows])) for rows in self.rows), default=0.0)


def close(loop: KinematicLoop, start: np.ndarray, free: list[int]) -> tuple[np.ndarray, float]:
    """Return the pose that Newton reaches from `start` by moving the joints in `free`, and its largest gap [m].

    The steps have minimum norm, so redundant rows and spare freedom do no harm. Steps are shortened if they are too long or
    do not reduce the residual. The pose may be open.
    """
    q = np.array(start, dtype=float)
    phi, jacobian = loop.residual(q)
    if phi.size == 0 or not free:
        return q, loop.gap(phi)
    rcond = _LEAST_SINGULAR_SHARE if loop.rank_tolerance <= RANK_TOLERANCE else loop.rank_tolerance
    for _ in range(100):
        step = np.zeros_like(q)
        step[free] = np.linalg.lstsq(jacobian[:, free], -phi, rcond=rcond)[0]
        size = np.abs(step).max()
        if not np.isfinite(size) or size < 1e-15:
            break
        scale = min(1.0, _MAX_STEP / size)
        norm = np.linalg.norm(phi)
        while scale > 1e-6:
            trial = q + scale * step
            phi_trial, jacobian_trial = loop.residual(trial)
            if np.linalg.norm(phi_trial) < norm:
                break
            scale *= 0.5
        else:
            break
        q, phi, jacobian = trial, phi_trial, jacobian_trial
    return q, loop.gap(phi)


def least_gap(loop: KinematicLoop, start: np.ndarray, free: list[int]) -> float:
    """Return the smallest gap [m] near `start` of a loop that does not close, by least squares."""
    import scipy

    def at(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        q = np.array(start, dtype=float)
        q[free] = x
        phi, jacobian = loop.residual(q)
        return phi, jacobian[:, free]

    if not free:
        return loop.gap(loop.residual(start)[0])
    found = scipy.optimize.least_squares(
        lambda x: at(x)[0], start[free], lambda x: at(x)[1], xtol=1e-8, ftol=1e-8, gtol=1e-14, max_nfev=200
    )
    return loop.gap(found.fun)


def follow(
    loop: KinematicLoop, start: np.ndarray, held: dict[int, float], longest_step: float = 0.035
) -> tuple[np.ndarray, float]:
    """Return the pose and gap [m] after moving the joints in `held` from the closed pose `start` to their values.

    The held joints move on a straight line in steps of at most `longest_step` [rad or m], so that Newton stays on the
    branch. If the loop opens on the way, the pose and gap there are returned.
    """
    free = [i for i in range(len(start)) if i not in held]
    joints, goal = list(held), np.array(list(held.values()))
    begin = start[joints]
    n_steps = max(1, int(np.ceil(np.abs(goal - begin).max() / longest_step)))
    q, gap = start, 0.0
    for fraction in np.linspace(0.0, 1.0, n_steps + 1)[1:]:
        trial = np.array(q)
        trial[joints] = begin + fraction * (goal - begin)
        q, gap = close(loop, trial, free)
        if gap > loop.closed_m:
            break
    return q, gap
