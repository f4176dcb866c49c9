"""Objectives: a weighted sum of terms, each an integral over the motion in SI units."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from linkplan.models.errors import ProblemError
from linkplan.models.names import nearest
from linkplan.planner.problem.extra import ExtraCost, checked_extras
from linkplan.planner.problem.terms import TERMS, Term, term_of_cost


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Objective:
    """The sum of terms from `TERMS` and of `extra` costs, each with its positive weight per SI unit of the term."""

    weights: Mapping[str, float]
    extra: Sequence[ExtraCost] = ()
    terms: Mapping[str, Term] = field(init=False)

    def __post_init__(self) -> None:
        weights, extra = dict(self.weights), checked_extras(self.extra, ExtraCost, "extra_costs")
        if not weights and not extra:
            raise ProblemError(f"objective.minimize names at least one of {', '.join(TERMS)}")
        own = {cost.name: cost for cost in extra}
        for term in weights:
            if term not in TERMS and term not in own:
                raise ProblemError(f"objective.minimize is one of {', '.join(TERMS)}, got '{term}'{nearest(term, TERMS)}")
        for name in own:
            if name in TERMS:
                raise ProblemError(f"extra cost '{name}' has the name of a term of objective.minimize")
        weights |= {name: cost.weight for name, cost in own.items()}
        object.__setattr__(self, "weights", weights)
        object.__setattr__(self, "extra", extra)
        terms = {name: term_of_cost(own[name]) if name in own else TERMS[name] for name in weights}
        object.__setattr__(self, "terms", terms)

    def __reduce__(self) -> tuple:
        return objective_from, (self.weights, self.extra)  # terms are functions, which are not pickled

    def has(self, *terms: str) -> bool:
        """Check that any of the terms is in the sum."""
        return any(term in self.weights for term in terms)

    def weight(self, term: str) -> float:
        """Return a term's weight; 0 for a term that is not in the sum."""
        return self.weights.get(term, 0.0)

    def efforts(self, *shapes: str) -> bool:
        """Check that a term gives efforts one of these shapes (`Term.efforts`)."""
        return any(term.efforts in shapes for term in self.terms.values())

    @property
    def is_smoothed(self) -> bool:
        """Whether programs add a weight on the squared effort rate, because efforts might chatter without it."""
        return any(term.chatters for term in self.terms.values()) and not self.efforts("bend", "smooth")

    @property
    def unit(self) -> str:
        """The SI unit of an objective with one term; empty for a sum."""
        return next(iter(self.terms.values())).unit if len(self.terms) == 1 else ""

    @property
    def name(self) -> str:
        """The objective as a phrase: a term's name, or the weighted sum."""
        if list(self.weights.values()) == [1.0]:
            return next(iter(self.weights))
        return " + ".join(term if weight == 1 else f"{weight:g} {term}" for term, weight in self.weights.items())


def objective_from(value: Objective | str | Mapping[str, float], extra: Sequence[ExtraCost] = ()) -> Objective:
    """Return the objective described by a term's name or a table of weights, with extra costs added."""
    if isinstance(value, Objective):
        return value
    if isinstance(value, str):
        return Objective(weights={value: 1.0}, extra=extra)
    return Objective(weights=value, extra=extra)
