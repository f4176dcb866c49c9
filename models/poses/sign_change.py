"""The roots of functions of one variable by Ridders' method. Importing scipy.optimize takes longer than the search."""

from collections.abc import Callable
from typing import Any

import numpy as np


def sign_change(function: Callable, a: float | np.ndarray, b: float | np.ndarray, xtol: float) -> Any:
    """Return x between a and b where f(x) = 0, to xtol, by Ridders' method (IEEE Trans. Circuits Syst. 26, 1979).

    The values of f at the ends have opposite signs, or one of them is 0. The root stays bracketed. With arrays a and b (n,)
    f gives the values (n,) of n functions, each at its own x, and all roots are found together: NaN where f has been NaN.
    """
    low, high = np.array(a, dtype=float), np.array(b, dtype=float)
    at_low, at_high = np.array(function(low)), np.array(function(high))
    found, done = np.full(low.shape, np.nan), np.full(low.shape, fill_value=False)
    x = found
    for _ in range(100):
        middle, before = 0.5 * (low + high), x
        at_middle = np.array(function(middle))
        scale = np.sqrt(np.maximum(at_middle * at_middle - at_low * at_high, 0.0))  # a lost root has no bracket
        x = middle + (middle - low) * np.sign(at_low - at_high) * at_middle / np.where(scale == 0, 1.0, scale)
        points = np.array([low, middle, x, high])
        values = np.array([at_low, at_middle, function(x), at_high])
        order = np.argsort(np.abs(points - low), axis=0)
        points, values = (np.take_along_axis(of, order, axis=0) for of in (points, values))
        first = np.argmax(values[:-1] * values[1:] <= 0, axis=0)[None]
        low, high = (np.take_along_axis(points, first + k, axis=0)[0] for k in (0, 1))
        at_low, at_high = (np.take_along_axis(values, first + k, axis=0)[0] for k in (0, 1))
        middle = np.where(at_low == 0, low, np.where(at_high == 0, high, 0.5 * (low + high)))
        narrow = (np.abs(high - low) <= xtol) | (middle == low) | (middle == high)
        lost = np.isnan(values).any(axis=0)
        near = ~done & ~lost & (narrow | (np.abs(x - before) <= xtol))
        found, done = np.where(near, np.where(narrow, middle, x), found), done | near | lost
        if np.all(done):
            break
    return found[()]
