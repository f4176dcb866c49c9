"""How far a motion's ends are from what is asked of them."""

import numpy as np


def missed(values: np.ndarray, low: np.ndarray, high: np.ndarray, size: np.ndarray | float) -> float:
    """Return by how much of their sizes values (..., n) are outside of [low, high] at the most; 0 where all are within."""
    return float((np.maximum(low - values, values - high) / size).max(initial=0.0))


def exactly(asked: np.ndarray, free: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds, low and high, of what is asked exactly; infinite where it is NaN or `free`."""
    nothing = np.isnan(asked) if free is None else free
    return np.where(nothing, -np.inf, asked), np.where(nothing, np.inf, asked)
