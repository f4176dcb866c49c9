"""What a simulated machine's imperfections are drawn from: one spread of values for each, in a problem file's units.

Planning knows nothing of them: they are kept for studies that run trackers on machines unlike the model.
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
    """Where a value lies: "fixed" at `first`, "uniform" from `first` to `second`, or "normal" with mean and deviation."""

    kind: str
    first: float
    second: float = 0.0

    @property
    def random(self) -> bool:
        """Whether different machines have different values."""
        return (self.kind == "normal" and self.second > 0) or (self.kind == "uniform" and self.second > self.first)


@dataclass(frozen=True, slots=True, kw_only=True)
class Factor:
    """One number of a machine that can be wrong: which quantity, of what (a joint, actuator or body; "" of all), and how."""

    key: str
    name: str
    spread: Spread

    @property
    def label(self) -> str:
        """The key, and what it is of."""
        return f"{self.key}.{self.name}" if self.name else self.key

    @property
    def quantity(self) -> Quantity:
        """The quantity that the key names."""
        return QUANTITIES[self.key]


def is_spread(value: object) -> bool:
    """Return whether a table is a distribution, and no table of values by name."""
    return isinstance(value, Mapping) and bool(value) and set(value) <= {"normal", "uniform"}


def spread_of(value: object, key: str, label: str) -> Spread:
    """Return the spread that a file's value means.

    Raises:
        ProblemError: when it is none, or lies outside of what is legal for the key.
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
    """Refuse keys that are none.

    Raises:
        ProblemError: with the nearest key.
    """
    for key in table:
        if key not in KEYS:
            raise ProblemError(f"unknown key 'imperfections.{key}'{nearest(key, KEYS)}; keys are {', '.join(KEYS)}")
