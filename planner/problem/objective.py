"""What a motion is best in: a weighted sum of terms, each an integral over the motion in SI units."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.models.names import nearest
from linkplan.planner.keys.kinds import Term

# Term: what it is, and its unit.
TERMS: Mapping[Term, tuple[str, str]] = {
    "effort": ("integral of the squared efforts", "N2 m2 s"),
    "time": ("duration", "s"),
    "tracking": ("integral of the squared distance from the reference", "rad2 s"),
    "work": ("positive mechanical work of the actuators", "J"),
    "copper_loss": ("integral of the motors' resistance times squared current", "J"),
    "effort_rate": ("integral of the squared effort rates", "N2 m2 / s"),
    "closure_force": ("integral of the squared closure forces", "N2 s"),
}
# Terms that make the best effort unique and smooth; without one of them a motion may chatter.
QUADRATIC = ("effort", "copper_loss", "effort_rate")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Objective:
    """The sum of terms out of `TERMS`, each with its positive weight, per SI unit of the term."""

    weights: Mapping[str, float]

    def __post_init__(self) -> None:
        if not self.weights:
            raise ProblemError(f"objective.minimize names at least one of {', '.join(TERMS)}")
        for term, weight in self.weights.items():
            if term not in TERMS:
                raise ProblemError(f"objective.minimize is one of {', '.join(TERMS)}, got '{term}'{nearest(term, TERMS)}")
            if not (np.isfinite(weight) and weight > 0):
                raise ProblemError(f"objective.minimize.{term} is a positive weight, got {weight!r}")
        object.__setattr__(self, "weights", dict(self.weights))

    def has(self, *terms: str) -> bool:
        """Return whether any of the terms is in the sum."""
        return any(term in self.weights for term in terms)

    def weight(self, term: str) -> float:
        """Return a term's weight, 0 where it is not in the sum."""
        return self.weights.get(term, 0.0)

    @property
    def name(self) -> str:
        """The objective in a few words: a term's name, or the weighted sum."""
        if list(self.weights.values()) == [1.0]:
            return next(iter(self.weights))
        return " + ".join(term if weight == 1 else f"{weight:g} {term}" for term, weight in self.weights.items())


def objective_from(value: object) -> Objective:
    """Return the objective that a term's name or a table of weights means."""
    if isinstance(value, Objective):
        return value
    if isinstance(value, str):
        return Objective(weights={value: 1.0})
    if not isinstance(value, Mapping):
        raise ProblemError(f"objective.minimize is a term ({', '.join(TERMS)}) or a table of term = weight, got {value!r}")
    return Objective(weights=value)
