"""Numbers as a page shows them: samples thinned to what a screen has room for, digits to what is known."""

import math
from itertools import pairwise

import numpy as np

# Samples of a line: more than a screen's width has pixels for two.
MOST = 800
# Digits of a value, counted from the largest of its kind; on a logarithmic axis each value has its own.
_DIGITS, _OWN_DIGITS = 5, 4
# What a sample is off a line by, as a share of the line's range, below which nobody sees it.
_SEEN = 0.01


def rounded(values: np.ndarray, *, log: bool = False, digits: int = _DIGITS) -> list:
    """Return values (n,) or (n, m) as lists, rounded; None where a value is not finite or, with `log`, not positive."""
    values = np.asarray(values, dtype=float)
    if values.ndim > 1:
        scale = _scale(values)
        return [_rounded(row, scale, log, digits) for row in values]
    return _rounded(values, _scale(values), log, digits)


def _scale(values: np.ndarray) -> float:
    known = np.abs(values[np.isfinite(values)])
    return float(known.max(initial=0.0))


def _rounded(row: np.ndarray, scale: float, log: bool, digits: int) -> list[float | int | None]:
    if log:
        return [float(f"{x:.{_OWN_DIGITS}g}") if math.isfinite(x) and x > 0 else None for x in row.tolist()]
    places = digits - 1 - math.floor(math.log10(scale)) if scale > 0 else 0
    return [_plain(round(x, places)) if math.isfinite(x) else None for x in row.tolist()]


def _plain(value: float) -> float | int:
    return int(value) if value == int(value) else value


def times(values: np.ndarray) -> list:
    """Return instants (n,) [s] to a millionth of their span, as lists."""
    values = np.asarray(values, dtype=float)
    return rounded(values, digits=7)


def kept(columns: np.ndarray, most: int = MOST) -> np.ndarray:
    """Return the indices of the rows of columns (n, k) that lines of them need: all, or so many even ones and the peaks.

    Of the rows between two even ones that one stays, for every column, which is furthest from the straight line between
    them, where that is more than a screen shows: a peak of one sample is still drawn.
    """
    columns = np.asarray(columns, dtype=float)
    n = len(columns)
    if n <= most:
        return np.arange(n)
    even = np.linspace(0, n - 1, most // 2).astype(int)
    found = set(even.tolist())
    for values in np.nan_to_num(columns.T):
        off = np.abs(values - np.interp(np.arange(n), even, values[even]))
        least = _SEEN * float(np.ptp(values))
        for a, b in pairwise(even.tolist()):
            k = a + int(np.argmax(off[a:b]))
            if off[k] > least:
                found.add(k)
    return np.array(sorted(found))
