"""Imperfections of simulated machines: a distribution for each quantity, in a problem file's units.

Planning does not use them. Studies use them to run trackers on machines that differ from the model.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from linkplan.models.errors import ModelError, ProblemError, nearest
from linkplan.models.mechanism import Mechanism
from linkplan.models.parameters import chosen_parameters
from linkplan.planner.problem.keys.imperfections import QUANTITIES, WORDS
from linkplan.planner.problem.keys.reading import refuse_unknown_keys
from linkplan.planner.problem.keys.section import FORMS, Quantity
from linkplan.planner.problem.parameters import read_parameters
from linkplan.planner.problem.settings import number


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
        ProblemError: if it is not a distribution, or outside the legal range of the key.
    """
    where = f"imperfections.{label}"
    kind, pair = "uniform", value
    if isinstance(value, Mapping):
        if not is_spread(value) or len(value) != 1:
            raise ProblemError(f"{where} must be {FORMS}, got {value!r}")
        ((kind, pair),) = value.items()
    if not isinstance(pair, list | tuple):
        if isinstance(value, Mapping | bool) or not isinstance(value, int | float):
            raise ProblemError(f"{where} must be {FORMS}, got {value!r}")
        return Spread(kind="fixed", first=_legal(value, key, where))
    if len(pair) != 2:
        raise ProblemError(f"{where} must be {FORMS}, got {value!r}")
    first = _legal(pair[0], key, where)
    if kind == "normal":
        return Spread(kind=kind, first=first, second=number(pair[1], f"{where}: the standard deviation", at_least_zero=True))
    second = _legal(pair[1], key, where)
    if second < first:
        raise ProblemError(f"{where} must have its low end first, got {value!r}")
    return Spread(kind=kind, first=first, second=second)


def _legal(value: object, key: str, where: str) -> float:
    found, quantity = number(value, where), QUANTITIES[key]
    if not quantity.low <= found <= quantity.high:
        unit = "" if quantity.unit == "1" else f" [{quantity.unit}]"
        raise ProblemError(f"{where} must be from {quantity.low:g} to {quantity.high:g}{unit}, got {found:g}")
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class ImperfectionFactors:
    """The section's quantities with their distributions, and the pushed body or joint."""

    factors: tuple[Factor, ...]
    push_body: str | None = None
    push_joint: str | None = None


def imperfections_of(table: Any, mechanism: Mechanism) -> ImperfectionFactors:
    """Return a file's [imperfections] for a mechanism; a value without names applies to every joint, actuator or body.

    Raises:
        ProblemError: for a key, name, or value that cannot be used.
    """
    refuse_unknown_keys({"imperfections": table})
    factors: list[Factor] = []
    for key, value in table.items():
        if key in WORDS or key == "parameters":
            continue
        names = _names(QUANTITIES[key].of, mechanism)
        if QUANTITIES[key].of and not names:
            raise ProblemError(f"imperfections.{key} applies to {_WHAT[QUANTITIES[key].of]}; the mechanism has none")
        if not QUANTITIES[key].of:
            factors.append(Factor(key=key, name="", spread=spread_of(value, key, key)))
        elif isinstance(value, Mapping) and not is_spread(value):
            for name, one in value.items():
                if name not in names:
                    raise ProblemError(
                        f"imperfections.{key} names '{name}'{nearest(name, names)}; {_WHAT[QUANTITIES[key].of]} are"
                        f" {', '.join(names)}"
                    )
                factors.append(Factor(key=key, name=name, spread=spread_of(one, key, f"{key}.{name}")))
        else:
            spread = spread_of(value, key, key)
            factors += [Factor(key=key, name=name, spread=spread) for name in names]
    for name, one in _numbers(table.get("parameters", {}), mechanism).items():
        factors.append(Factor(key="parameters", name=name, spread=spread_of(one, "parameters", f"parameters.{name}")))
    pushed = {word: _word(table, word, mechanism) for word in WORDS}
    _check_push({factor.key for factor in factors}, pushed)
    return ImperfectionFactors(factors=tuple(factors), **pushed)


def drawn_parameters(mechanism: Mechanism) -> dict[str, Any]:
    """Return the distributions [SI] of the numbers in [parameters], each by its `range`, else its `sd` or `tolerance`."""
    values, drawn = {one.name: one.value for one in mechanism.parameters}, {}
    for name, one in read_parameters(mechanism.source.get("parameters", {})).items():
        if one.range is not None:
            drawn[name] = list(one.range)
        elif one.sd is not None:
            drawn[name] = {"normal": [values[name], one.sd]}
        elif one.tolerance is not None:
            drawn[name] = [values[name] - one.tolerance, values[name] + one.tolerance]
    return drawn


def _numbers(given: Any, mechanism: Mechanism) -> dict[str, Any]:
    """Return the distributions of numbers of the model by name: those given, and of the others those of [parameters]."""
    if not isinstance(given, Mapping) or is_spread(given):
        raise ProblemError(f"imperfections.parameters must be a table by name; each value is {FORMS}, got {given!r}")
    numbers = drawn_parameters(mechanism) | given
    known = {one.name for one in mechanism.parameters}
    try:
        chosen = chosen_parameters(mechanism.model, numbers)
    except ModelError as error:
        raise ProblemError(f"imperfections.parameters: {error}") from error
    for one in chosen:
        if one.name not in known and np.any(mechanism.model.body_simple):
            raise ProblemError(
                f"imperfections.parameters names '{one.name}', which this model's compiler has folded; name it in"
                " [parameters], too"
            )
    return numbers


_WHAT = {
    "hinge": "independent hinges",
    "slide": "independent slides",
    "joint": "joints",
    "actuator": "actuators",
    "body": "moving bodies",
}


def _names(of: str, mechanism: Mechanism) -> list[str]:
    if of in ("hinge", "slide"):
        return [joint.name for joint in mechanism.independent_joints if joint.kind == of]
    if of == "joint":
        return [joint.name for joint in mechanism.joints]
    if of == "actuator":
        return [actuator.name for actuator in mechanism.actuators]
    model = mechanism.model
    return [model.body(i).name for i in range(1, model.nbody) if model.body_dofnum[i] > 0]


def _word(table: Mapping, word: str, mechanism: Mechanism) -> str | None:
    value = table.get(word)
    if value is None:
        return None
    names = _names("joint", mechanism)
    if word == "push_body":
        names = [mechanism.model.body(i).name for i in range(1, mechanism.model.nbody)]
    if not isinstance(value, str) or value not in names:
        hint = nearest(value, names) if isinstance(value, str) else ""
        raise ProblemError(f"imperfections.{word} must be one of {', '.join(names)}, got {value!r}{hint}")
    return value


def _check_push(keys: set[str], pushed: dict[str, str | None]) -> None:
    forces = sorted(key for key in keys if key.startswith("push_force"))
    wanted = {"push_body": forces[:1], "push_joint": ["push_effort"] if "push_effort" in keys else []}
    for word, needs in wanted.items():
        if needs and pushed[word] is None:
            raise ProblemError(f"imperfections.{needs[0]} needs the target of the push: imperfections.{word}")
        if pushed[word] is not None and not needs:
            lack = "push_force_x_n, _y_n or _z_n" if word == "push_body" else "push_effort"
            raise ProblemError(f"imperfections.{word} needs the force of the push: imperfections.{lack}")
    if any(pushed.values()) and "push_duration_s" not in keys:
        raise ProblemError("a push needs imperfections.push_duration_s [s] (and push_start_s, by default 0)")
