"""Numbers on a page: curves thinned to screen resolution, rounded values, names of a drawing's directions."""

import math
from itertools import pairwise

import numpy as np

_AXES = ("x", "y", "z")
# Number of samples of a line: about half the width of a screen in pixels.
MAX_SAMPLES = 800
# A smaller range of values, as a share of the largest, may be due to rounding and is not resolved.
_LEAST_SPAN_SHARE = 1e-4


def direction_name(direction: np.ndarray) -> str:
    """Return the name of a direction (3,): an axis of the world with its sign, or its components."""
    k = int(np.argmax(np.abs(direction)))
    if 1.0 - abs(direction[k]) < 1e-6:
        return _AXES[k] if direction[k] > 0 else f"-{_AXES[k]}"
    return "along (" + ", ".join(f"{round(float(x), 6) + 0.0:.3g}" for x in direction) + ")"


def significant(value: float | None, digits: int = 4) -> float | None:
    """Return a number rounded to `digits` significant digits; None for None and for a number that is not finite."""
    return float(f"{value:.{digits}g}") + 0.0 if value is not None and math.isfinite(value) else None  # 0 for -0


def rounded(values: np.ndarray, *, log: bool = False, digits: int = 5) -> list:
    """Return values (n,) or (n, m) as lists, rounded.

    The digits are counted from the largest value, or from ten times the range of values (n,) that hardly change. With `log`,
    every value has four significant digits. Values that are not finite or, with `log`, not positive become None.
    """
    values = np.asarray(values, dtype=float)
    if log:
        rows = [[significant(x) if x > 0 else None for x in row] for row in np.atleast_2d(values).tolist()]
    else:
        known = values[np.isfinite(values)]
        scale = float(np.abs(known).max(initial=0.0))
        if values.ndim == 1 and len(known):
            scale = min(scale, max(10 * float(np.ptp(known)), _LEAST_SPAN_SHARE * scale))
        places = digits - 1 - math.floor(math.log10(scale)) if scale > 0 else 0
        rows = [[_plain(x) for x in row] for row in np.round(np.atleast_2d(values), places).tolist()]
    return rows if values.ndim > 1 else rows[0]


def _plain(value: float) -> float | int | None:
    if value.is_integer():
        return int(value)
    return value if math.isfinite(value) else None


def rounded_times(values: np.ndarray) -> list:
    """Return instants (n,) [s] to a millionth of their span, as lists."""
    return rounded(values, digits=7)


def drawn_rows(columns: np.ndarray, most: int = MAX_SAMPLES) -> np.ndarray:
    """Return the rows of columns (n, k) to draw, as indices: all if n <= `most`, else `most / 2` even ones and the peaks.

    Between two of these rows, each column keeps the row furthest from the straight line between them, if the distance is
    more than 1 % of the column's range. A peak of a single sample is therefore drawn.
    """
    columns = np.asarray(columns, dtype=float)
    n = len(columns)
    if n <= most:
        return np.arange(n)
    even = np.linspace(0, n - 1, most // 2).astype(int)
    found = set(even.tolist())
    for values in np.nan_to_num(columns.T):
        distance = np.abs(values - np.interp(np.arange(n), even, values[even]))
        visible = 0.01 * float(np.ptp(values))
        for a, b in pairwise(even.tolist()):
            k = a + int(np.argmax(distance[a:b]))
            if distance[k] > visible:
                found.add(k)
    return np.array(sorted(found))
