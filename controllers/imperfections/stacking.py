"""Settings of many machines as one array. Written for speed: broadcasting each one takes longer than a control period."""

from collections.abc import Sequence

import numpy as np


def stacked(values: Sequence, width: int) -> np.ndarray:
    """Return numbers or rows (width,) of n machines as an array (n, width)."""
    if all(isinstance(value, int | float) for value in values):
        return np.repeat(np.array(values, dtype=float)[:, None], width, axis=1)
    return np.array([np.broadcast_to(value, (width,)) for value in values], dtype=float)
