"""Intervals as problem files write them, refused in one line that names their key."""

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.planner.problem.values import number


def interval(value: list[float], key: str, *, point: bool = False) -> tuple[float, float]:
    """Return [low, high], low below high, or the same where a `point` will do; infinite ends admitted."""
    low, high = (end if np.isinf(end) else number(end, key) for end in value)
    if not (low < high or (point and low == high)):
        raise ProblemError(f"{key} is [low, high] with low {'<=' if point else '<'} high, got [{low:g}, {high:g}]")
    return low, high
