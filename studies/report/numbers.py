"""Numbers as a page shows them: samples thinned to what a screen has room for, digits to what is known."""

import math

import numpy as np

# Samples of a line: more than a screen's width has pixels for two.
MOST = 800
# Digits of a value, counted from the largest of its kind; on a logarithmic axis each value has its own.
_DIGITS, _OWN_DIGITS = 5, 4


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
    """Return the indices of the rows of columns (n, k) that a line of each needs: all, or every stretch's extremes.

    Rows are cut into stretches; of each its first row and the least and largest value of every column stay, so that a
    peak of one sample is still drawn.
    """
    columns = np.asarray(columns, dtype=float)
    n, k = columns.shape
    if n <= most:
        return np.arange(n)
    stretches = max(40, most // (1 + 2 * k))
    edges = np.linspace(0, n, stretches + 1).astype(int)
    found = {n - 1, *edges[:-1].tolist()}
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        part = np.nan_to_num(columns[a:b])
        found |= set((a + part.argmin(axis=0)).tolist()) | set((a + part.argmax(axis=0)).tolist())
    return np.array(sorted(found))
