"""Errors of a motion's boundary states."""

import numpy as np

# Boundary states, and sites at them, are constraints of the program and kept to rounding: the allowed error as a share of
# the motion's span or largest speed, or of the mechanism's extent.
BOUNDARY_SHARE = 1e-6


Bounds = tuple[np.ndarray, np.ndarray] | np.ndarray


def relative_violation(values: np.ndarray, bounds: Bounds, size: np.ndarray | float) -> float:
    """Return the largest amount, in units of `size`, by which values (..., n) lie outside the bounds, low and high (2, n).

    It is 0 if all are inside.
    """
    low, high = bounds
    return float((np.maximum(low - values, values - high) / size).max(initial=0.0))


def exact_bounds(asked: np.ndarray, free: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds, low and high, of prescribed values; infinite where these are NaN or `free`."""
    open_values = np.isnan(asked) if free is None else free
    return np.where(open_values, -np.inf, asked), np.where(open_values, np.inf, asked)
