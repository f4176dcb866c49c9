"""Values of a problem: numbers and words, each refused in one line that names its key as problem files have it."""

from collections.abc import Mapping, Sequence

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.models.names import choose

# No quantity of a mechanism is larger in SI units or degrees.
_LARGEST = 1e15


# What a key may be at the most where more only asks for memory and time, in its own unit; all others stay below `_LARGEST`.
_RANGES: Mapping[str, tuple[float, float]] = {
    "motion.duration_s": (1e-6, 1e5),
    "motion.min_duration_s": (1e-9, 1e5),
    "motion.max_duration_s": (1e-6, 1e5),
    "guess.duration_s": (1e-6, 1e5),
    "reference.frequency_hz": (1e-5, 1e5),
    "tracking.period_s": (1e-7, 10.0),
    "tracking.duration_s": (1e-6, 1e5),
    "tracking.kp": (0.0, 1e12),
    "tracking.kd": (0.0, 1e12),
    "solver.max_time_s": (1e-9, 1e7),
}


def frozen(value: object) -> np.ndarray:
    """Return an array of floats that cannot be written to."""
    array = np.array(value, dtype=float)
    array.flags.writeable = False
    return array


def number(value: object, key: str, *, positive: bool = False, infinite: bool = False, least: float | None = None) -> float:
    """Return a finite number.

    Raises:
        ProblemError: naming the key, when it is anything else.
    """
    value = _plain(value)
    wanted = "a positive number" if positive else "a number" if least is None else f"a number of at least {least:g}"
    legal = isinstance(value, int | float) and not isinstance(value, bool)
    if isinstance(value, int) and abs(value) > _LARGEST:
        raise ProblemError(f"{key} is {wanted} below {_LARGEST:g}, got one of {len(str(value))} digits")
    if not legal or np.isnan(value) or (np.isinf(value) and not infinite):
        raise ProblemError(f"{key} is {wanted}, got {value!r}")
    if (positive and value <= 0) or (least is not None and value < least):
        raise ProblemError(f"{key} is {wanted}, got {value!r}")
    low, high = _RANGES.get(key, (-_LARGEST, _LARGEST))
    if np.isfinite(value) and not low <= value <= high:
        raise ProblemError(f"{key} is {wanted} from {low:g} to {high:g}, got {value!r}")
    return float(value)


def whole(value: object, key: str, low: int, high: int) -> int:
    """Return a whole number from `low` to `high`.

    Raises:
        ProblemError: naming the key, when it is anything else.
    """
    value = _plain(value)
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise ProblemError(f"{key} is a whole number from {low} to {high}, got {value!r}")
    return value


def one_of(value: object, key: str, legal: Sequence[str]) -> str:
    """Return a name, one of the legal ones.

    Raises:
        ProblemError: naming the key, when it is anything else.
    """
    if not isinstance(value, str):
        raise ProblemError(f"{key} is one of {', '.join(legal)}, got {value!r}")
    return choose(key, value, legal, ProblemError)


def _plain(value: object) -> object:
    """Return numpy's numbers as Python's own, everything else as it is."""
    return value.item() if isinstance(value, np.generic) else value
