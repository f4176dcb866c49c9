"""Integration under a plan's efforts, interval by interval: restarted at each interval's end, where efforts may jump."""

import itertools
import time
from collections.abc import Callable, Iterator

import numpy as np
from scipy.integrate import solve_ivp

from linkplan.models.interrupts import check

# The integration's own error: two digits below the 1e-10 that certificates speak of.
_RTOL, _ATOL = 1e-12, 1e-13
# The most evaluations of the dynamics on one interval, sixteen hundred steps; where a motion is one, some ten do. At a fold
# where the reduced dynamics end, steps become ever smaller.
_EVALUATIONS = 20_000

# From the time since an interval's beginning [s] and the state (n,) to its rate (n,).
Rate = Callable[[float, np.ndarray], np.ndarray]


class _CrawlsError(Exception):
    """Integration of an interval needs more evaluations than any feasible motion does, or more time than there is."""


def flow(rate: Rate, width_s: float, state: np.ndarray, shares: np.ndarray, until: float = np.inf) -> np.ndarray | None:
    """Return the states (m, n) at shares (m,) of an interval, from one at its beginning; None where it fails.

    `until` is on the monotonic clock [s]: what is not done by then has failed.
    """
    atol = _ATOL * np.maximum(1.0, np.abs(state))
    # An infeasible motion may diverge: the outcome shows it, and needs no warnings.
    with np.errstate(all="ignore"):
        try:
            result = solve_ivp(
                _counted(rate, until), (0.0, width_s), state, method="DOP853", rtol=_RTOL, atol=atol, t_eval=shares * width_s
            )
        except _CrawlsError:
            return None
    reached = result.success and result.y.shape[1] == len(shares) and np.all(np.isfinite(result.y[:, -1]))
    return result.y.T if reached else None


def flows(
    rate_on: Callable[[int], Rate], breaks_s: np.ndarray, state: np.ndarray, shares: np.ndarray, until: float = np.inf
) -> Iterator[np.ndarray | None]:
    """Yield the states (m, n) on one interval after the other, each from where the last ended; None where one fails.

    Args:
        rate_on: an interval's right-hand side, by its number.
        breaks_s: (n + 1,) of the intervals [s].
        state: (n,) at the start.
        shares: shares (n_shares,) of an interval, the last of them 1.
        until: as of `flow`.
    """
    for k, width in enumerate(np.diff(breaks_s)):
        reached = flow(rate_on(k), width, state, shares, until)
        yield reached
        if reached is None:
            return
        state = reached[-1]


def _counted(rate: Rate, until: float) -> Rate:
    """Return a right-hand side that may be called so often, and so long, and no more."""
    calls = itertools.count()

    def counted(t: float, y: np.ndarray) -> np.ndarray:
        check()
        if next(calls) > _EVALUATIONS or time.monotonic() > until:
            raise _CrawlsError
        return rate(t, y)

    return counted
