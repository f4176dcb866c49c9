"""Conversion of a problem's values; illegal values are refused in one line that names the key of problem files."""

from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.planner.keys.kinds import AtLeastZero, Number, Positive
from linkplan.planner.keys.reading import read

# The default of a field that __post_init__ sets: readers of the field find its type, and never None.
DERIVED: Any = None


def frozen(value: object) -> np.ndarray:
    """Return a read-only array of floats."""
    array = np.array(value, dtype=float)
    array.flags.writeable = False
    return array


def number(value: object, key: str, *, positive: bool = False, at_least_zero: bool = False) -> float:
    """Return a finite number.

    Raises:
        ProblemError: naming the key, when it is anything else.
    """
    kind: Any = Positive if positive else AtLeastZero if at_least_zero else Number
    return read(kind, plain(value), key)


def interval(value: list[float], key: str, *, point: bool = False) -> tuple[float, float]:
    """Return [low, high] with low < high, or low <= high for a `point`; ends may be infinite."""
    low, high = (end if np.isinf(end) else number(end, key) for end in value)
    if not (low < high or (point and low == high)):
        raise ProblemError(f"{key} is [low, high] with low {'<=' if point else '<'} high, got [{low:g}, {high:g}]")
    return low, high


def whole(value: object, key: str, low: int, high: int) -> int:
    """Return a whole number from `low` to `high`.

    Raises:
        ProblemError: naming the key, when it is anything else.
    """
    value = plain(value)
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise ProblemError(f"{key} is a whole number from {low} to {high}, got {value!r}")
    return value


def plain(value: Any) -> Any:
    """Return a copy of a value in the types of a TOML file; values without such a type are returned unchanged."""
    if isinstance(value, np.generic | np.ndarray):
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple | range):
        return [plain(item) for item in value]
    return str(value) if isinstance(value, PurePath) else value
