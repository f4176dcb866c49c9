"""The root of a function of one variable by Ridders' method. Importing scipy.optimize takes longer than the search."""

from collections.abc import Callable

import numpy as np


def sign_change(function: Callable[[float], float], a: float, b: float, xtol: float) -> float:
    """Return x between a and b where f(x) = 0, to xtol, by Ridders' method (IEEE Trans. Circuits Syst. 26, 1979).

    The values of f at the ends have opposite signs, or one of them is 0. The root stays bracketed.
    """
    at_a, at_b, before = function(a), function(b), np.inf
    if at_a == 0 or at_b == 0:
        return a if at_a == 0 else b
    for _ in range(100):
        middle = 0.5 * (a + b)
        if not abs(b - a) > xtol or middle in (a, b):
            break
        at_middle = function(middle)
        scale = np.sqrt(at_middle * at_middle - at_a * at_b)
        if at_middle == 0 or scale == 0:
            return middle
        x = middle + (middle - a) * np.sign(at_a - at_b) * at_middle / scale
        at_x = function(x)
        if at_x == 0 or abs(x - before) <= xtol:
            return float(x)
        before = x
        ends = [(a, at_a), (b, at_b), (middle, at_middle), (float(x), at_x)]
        (a, at_a), (b, at_b) = min(
            ((left, right) for left in ends for right in ends if left[1] < 0 < right[1]),
            key=lambda pair: abs(pair[0][0] - pair[1][0]),
        )
    return 0.5 * (a + b)
