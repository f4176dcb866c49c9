"""Values in a problem file: numbers, words and intervals, each refused in one line that names its key."""

from collections.abc import Sequence

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.models.names import choose

# No quantity of a mechanism is larger in SI units or degrees.
_LARGEST = 1e15


def word(section: dict, key: str, legal: Sequence[str], default: str | None = None) -> str:
    """Return the word under a key, one of the legal ones."""
    value = section.get(key.split(".")[1], default)
    if value is None:
        raise ProblemError(f"{key} is missing; it is one of {', '.join(legal)}")
    if not isinstance(value, str):
        raise ProblemError(f"{key} is one of {', '.join(legal)}, got {value!r}")
    return choose(key, value, legal, ProblemError)


def number(value: object, key: str, *, positive: bool = False, infinite: bool = False, least: float | None = None) -> float:
    """Return a finite number.

    Raises:
        ProblemError: naming the key, when it is anything else.
    """
    wanted = "a positive number" if positive else "a number" if least is None else f"a number of at least {least:g}"
    legal = isinstance(value, int | float) and not isinstance(value, bool)
    if isinstance(value, int) and abs(value) > _LARGEST:
        raise ProblemError(f"{key} is {wanted} below {_LARGEST:g}, got one of {len(str(value))} digits")
    if not legal or np.isnan(value) or (np.isinf(value) and not infinite):
        raise ProblemError(f"{key} is {wanted}, got {value!r}")
    if (positive and value <= 0) or (least is not None and value < least):
        raise ProblemError(f"{key} is {wanted}, got {value!r}")
    return float(value)


def interval(value: object, key: str) -> tuple[float, float]:
    """Return [low, high], low below high, infinite ends admitted."""
    if not isinstance(value, list) or len(value) != 2:
        raise ProblemError(f"{key} is [low, high], got {value!r}")
    low, high = (number(end, key, infinite=True) for end in value)
    if not low < high:
        raise ProblemError(f"{key} is [low, high] with low < high, got {value!r}")
    return low, high


def whole(value: object, key: str, low: int, high: int) -> int:
    """Return a whole number from `low` to `high`."""
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise ProblemError(f"{key} is a whole number from {low} to {high}, got {value!r}")
    return value
