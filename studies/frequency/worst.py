"""The worst of a figure over a continuous coordinate: a coarse scan, every local minimum of it refined."""

from collections.abc import Callable

import numpy as np
import scipy.optimize

# A minimum's place is found to this share of the two gaps of the scan that it lies in.
_PLACE = 1e-4
# A dip of the scan below both its neighbours of no more than this, of their size or of one, is rounding.
_ROUNDING = 1e-9


def local_minima(function: Callable[[float], float], at: np.ndarray, values: np.ndarray | None = None) -> list[float]:
    """Return where a function is least, near every local minimum of its values (n,) at increasing places (n,).

    Each is refined between its neighbours by Brent's bounded minimisation (Brent, Algorithms for Minimization Without
    Derivatives, 1973, 5); a place of the scan itself is left out. Infinite values are no minima.
    """
    scanned = np.array([function(x) for x in at] if values is None else values, dtype=float)
    walled = np.concatenate([[np.inf], np.where(np.isnan(scanned), np.inf, scanned), [np.inf]])
    here, before, after = walled[1:-1], walled[:-2], walled[2:]
    deep = np.maximum(before, after) > here + _ROUNDING * (1.0 + np.abs(np.where(np.isfinite(here), here, 0.0)))
    found = []
    for i in np.flatnonzero((here < before) & (here <= after) & deep):
        low, high = float(at[max(0, i - 1)]), float(at[min(len(at) - 1, i + 1)])
        if not low < high:
            continue
        best = scipy.optimize.minimize_scalar(
            function, bounds=(low, high), method="bounded", options={"xatol": _PLACE * (high - low)}
        )
        if best.fun < scanned[i]:
            found.append(float(best.x))
    return found
