"""The worst points of a function of one variable: its local minima, and the last argument before it fails."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np
import scipy.optimize

from linkplan.models.closure.rank import ROUNDING_SHARE

Broken = TypeVar("Broken")


def last_good(
    broken: Callable[[float], Broken | None], good: float, bad: float, why: Broken, tolerance: float
) -> tuple[float, Broken]:
    """Return the good argument nearest to `bad`, to a relative tolerance, and the value of `broken` just beyond it.

    `broken` returns None at good arguments; `why` is `broken(bad)`. All arguments are zero or positive.
    """
    while abs(bad - good) > tolerance * good:
        middle = 0.5 * (good + bad)
        there = broken(middle)
        if there is None:
            good = middle
        else:
            bad, why = middle, there
    return good, why


def refined_minima(function: Callable[[float], float], at: np.ndarray, values: np.ndarray | None = None) -> list[float]:
    """Return the arguments of the local minima near the minima of the scanned values (n,) at increasing arguments (n,).

    Each minimum is refined between its neighbours by Brent's bounded minimisation (Brent, Algorithms for Minimization
    Without Derivatives, 1973, ch. 5), to 1e-4 of the bracket. It is returned if it is below the scanned value. Infinite
    values are not minima.
    """
    scanned = np.array([function(x) for x in at] if values is None else values, dtype=float)
    walled = np.concatenate([[np.inf], np.where(np.isnan(scanned), np.inf, scanned), [np.inf]])
    here, before, after = walled[1:-1], walled[:-2], walled[2:]
    # Smaller dips are rounding.
    deep = np.maximum(before, after) > here + ROUNDING_SHARE * (1.0 + np.abs(np.where(np.isfinite(here), here, 0.0)))
    found = []
    for i in np.flatnonzero((here < before) & (here <= after) & deep):
        low, high = float(at[max(0, i - 1)]), float(at[min(len(at) - 1, i + 1)])
        if not low < high:
            continue
        with np.errstate(invalid="ignore"):  # it tries parabolas through infinite values
            best = scipy.optimize.minimize_scalar(
                function, bounds=(low, high), method="bounded", options={"xatol": 1e-4 * (high - low)}
            )
        if best.fun < scanned[i]:
            found.append(float(best.x))
    return found
