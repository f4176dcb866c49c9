"""Values as problem files write them: words under a key, and intervals, each refused in one line that names its key."""

from collections.abc import Sequence

from linkplan.models.errors import ProblemError
from linkplan.planner.problem.values import number, one_of


def word(section: dict, key: str, legal: Sequence[str], default: str | None = None) -> str:
    """Return the word under a key, one of the legal ones."""
    value = section.get(key.split(".")[1], default)
    if value is None:
        raise ProblemError(f"{key} is missing; it is one of {', '.join(legal)}")
    return one_of(value, key, legal)


def interval(value: object, key: str) -> tuple[float, float]:
    """Return [low, high], low below high, infinite ends admitted."""
    if not isinstance(value, list) or len(value) != 2:
        raise ProblemError(f"{key} is [low, high], got {value!r}")
    low, high = (number(end, key, infinite=True) for end in value)
    if not low < high:
        raise ProblemError(f"{key} is [low, high] with low < high, got {value!r}")
    return low, high
