"""Imperfections of simulated machines: a distribution for each quantity, in a problem file's units.

Planning does not use them. Studies use them to run trackers on machines that differ from the model.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from linkplan.models.errors import ProblemError
from linkplan.models.names import nearest
from linkplan.planner.keys.quantities import FORMS, QUANTITIES, WORDS, Quantity
from linkplan.planner.problem.values import number

KEYS = (*QUANTITIES, *WORDS)


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """A distribution: "fixed" at `first`, "uniform" from `first` to `second`, or "normal" with mean and deviation."""

    kind: str
    first: float
    second: float = 0.0

    @property
    def random(self) -> bool:
        """Whether values differ between machines."""
        return (self.kind == "normal" and self.second > 0) or (self.kind == "uniform" and self.second > self.first)


@dataclass(frozen=True, slots=True, kw_only=True)
class Factor:
    """A quantity that can be wrong, the joint, actuator or body that it belongs to ("" for all), and its distribution."""

    key: str
    name: str
    spread: Spread

    @property
    def label(self) -> str:
        """The key, with the name of the joint, actuator or body."""
        return f"{self.key}.{self.name}" if self.name else self.key

    @property
    def quantity(self) -> Quantity:
        """The quantity of the key."""
        return QUANTITIES[self.key]


def is_spread(value: object) -> bool:
    """Check that a table is a distribution and not a table of values by name."""
    return isinstance(value, Mapping) and bool(value) and set(value) <= {"normal", "uniform"}


def spread_of(value: object, key: str, label: str) -> Spread:
    """Return the distribution that a value of a file describes.

    Raises:
        ProblemError: when it is no distribution, or outside the legal range of the key.
    """
    where = f"imperfections.{label}"
    kind, pair = "uniform", value
    if isinstance(value, Mapping):
        if not is_spread(value) or len(value) != 1:
            raise ProblemError(f"{where} is {FORMS}, got {value!r}")
        ((kind, pair),) = value.items()
    if not isinstance(pair, list | tuple):
        if isinstance(value, Mapping | bool) or not isinstance(value, int | float):
            raise ProblemError(f"{where} is {FORMS}, got {value!r}")
        return Spread(kind="fixed", first=_legal(value, key, where))
    if len(pair) != 2:
        raise ProblemError(f"{where} is {FORMS}, got {value!r}")
    first = _legal(pair[0], key, where)
    if kind == "normal":
        return Spread(kind=kind, first=first, second=number(pair[1], f"{where}: the standard deviation", at_least_zero=True))
    second = _legal(pair[1], key, where)
    if second < first:
        raise ProblemError(f"{where} goes from its low end to its high end, got {value!r}")
    return Spread(kind=kind, first=first, second=second)


def _legal(value: object, key: str, where: str) -> float:
    found, quantity = number(value, where), QUANTITIES[key]
    if not quantity.low <= found <= quantity.high:
        unit = "" if quantity.unit == "1" else f" [{quantity.unit}]"
        raise ProblemError(f"{where} is from {quantity.low:g} to {quantity.high:g}{unit}, got {found:g}")
    return found


def refuse_unknown(table: Mapping) -> None:
    """Refuse unknown keys.

    Raises:
        ProblemError: with the nearest key.
    """
    for key in table:
        if key not in KEYS:
            raise ProblemError(f"unknown key 'imperfections.{key}'{nearest(key, KEYS)}; keys are {', '.join(KEYS)}")
