"""Intervals in problem files; illegal ones are refused in one line that names their key."""

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.planner.problem.values import number


def interval(value: list[float], key: str, *, point: bool = False) -> tuple[float, float]:
    """Return [low, high] with low < high, or low <= high for a `point`; ends may be infinite."""
    low, high = (end if np.isinf(end) else number(end, key) for end in value)
    if not (low < high or (point and low == high)):
        raise ProblemError(f"{key} is [low, high] with low {'<=' if point else '<'} high, got [{low:g}, {high:g}]")
    return low, high
