"""Objectives: a weighted sum of terms, each an integral over the motion in SI units.

A term has its integrand, its unit in a program, its requirements, and the resulting shape of efforts.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import get_args

import casadi as ca
import numpy as np

from linkplan.models.errors import ProblemError, nearest
from linkplan.planner.problem.extra import ExtraCost, checked_extras, expressed
from linkplan.planner.problem.instant import Instant, Scales
from linkplan.planner.problem.keys.kinds import Term as TermName
from linkplan.planner.problem.keys.limits import Motor

Motors = Sequence[Motor | None]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Term:
    """One term: an integral over the motion, or its `peak_effort`, which has no integrand.

    Args:
        words: description.
        unit: of the integral, SI.
        integrand: at an instant, in SI.
        size: a function of a program's units and the motors: the integral in SI for a scaled integrand of one; for an
            `exact` term one value per actuator.
        order: 2 for squares, 1 for terms linear in the motion's quantities; 0 for terms without a negligible size.
        exact: the cost of an interval (`COSTS`) that integrates it exactly; None for quadrature at nodes.
        needs: keys of `lacking_parts` (consistency.py).
        efforts: the optimal efforts "jump" between limits, "bend" where they reach a limit, or are "smooth".
        chatters: whether its optimal motion may chatter.
        positive_power: whether it needs the actuators' positive powers, which have kinks and are unknowns of a program.
    """

    words: str
    unit: str
    integrand: Callable[[Instant], ca.SX]
    size: Callable[[Scales, Motors], np.ndarray | float]
    order: int = 0
    exact: str | None = None
    needs: tuple[str, ...] = ()
    efforts: str = ""
    chatters: bool = False
    positive_power: bool = False

    def scale(self, scales: Scales, motors: Motors) -> float:
        """Return its unit in SI."""
        return float(np.max(self.size(scales, motors), initial=0.0))


def motor_losses(motors: Motors) -> np.ndarray:
    """Return the copper loss per squared effort (n_u,) of each motor; 0 if unknown."""
    return np.array([0.0 if motor is None else motor.loss for motor in motors])


TERMS: Mapping[str, Term] = {
    "effort": Term(
        words="integral of the squared efforts",
        unit="N2 m2 s",
        integrand=lambda at: ca.sumsqr(at.u),
        size=lambda scales, _: scales.time_s * scales.effort**2,
        order=2,
        exact="effort",
        efforts="bend",
    ),
    "time": Term(
        words="duration",
        unit="s",
        integrand=lambda _: ca.SX(1),
        size=lambda scales, _: np.array([scales.time_s]),
        exact="time",
        needs=("free duration",),
        efforts="jump",
    ),
    "tracking": Term(
        words="integral of the squared distance from the reference",
        unit="rad2 s",
        integrand=lambda at: ca.sumsqr(at.q[at.mechanism.independent.tolist()] - at.reference),
        size=lambda scales, _: scales.time_s * float(scales.position.max()) ** 2,
        order=2,
        needs=("reference", "fixed duration"),
        chatters=True,
    ),
    "work": Term(
        words="positive mechanical work of the actuators",
        unit="J",
        integrand=lambda at: ca.sum1(at.positive_powers),
        size=lambda scales, _: scales.time_s * scales.power,
        order=1,
        efforts="jump",
        chatters=True,
        positive_power=True,
    ),
    "copper_loss": Term(
        words="integral of the motors' resistance times squared current",
        unit="J",
        integrand=lambda at: ca.dot(ca.DM(at.losses), at.u**2),
        size=lambda scales, motors: scales.time_s * scales.effort**2 * motor_losses(motors),
        order=2,
        exact="effort",
        needs=("motors",),
        efforts="bend",
    ),
    "effort_rate": Term(
        words="integral of the squared effort rates",
        unit="N2 m2 / s",
        integrand=lambda at: ca.sumsqr(at.effort_rate),
        size=lambda scales, _: scales.effort**2 / scales.time_s,
        order=2,
        exact="effort_rate",
        needs=("changing efforts",),
        efforts="smooth",
    ),
    "jerk": Term(
        words="integral of the squared rates of the independent joints' accelerations",
        unit="rad2/s5",
        integrand=lambda at: ca.sumsqr(at.jerk),
        size=lambda scales, _: scales.position**2 / scales.time_s**5,
        order=2,
        exact="jerk",
        needs=("changing accelerations",),
    ),
    "peak_effort": Term(
        words="largest effort at any instant, as a share of its limit",
        unit="of the effort limit",
        integrand=lambda _: ca.SX(0),
        size=lambda *_: 1.0,
        exact="peak",
        needs=("effort limits",),
    ),
    "closure_force": Term(
        words="integral of the squared closure forces",
        unit="N2 s",
        integrand=lambda at: ca.sumsqr(at.closure_force),
        size=lambda scales, _: scales.time_s * scales.force**2,
        order=2,
        needs=("closures",),
    ),
    "shaking_force": Term(
        words="integral of the squared force on the frame, the weight included",
        unit="N2 s",
        integrand=lambda at: ca.sumsqr(at.joint_loads[:3, 0]),
        size=lambda scales, _: scales.time_s * scales.force**2,
        order=2,
    ),
}
assert set(TERMS) == set(get_args(TermName)), "keys.kinds.Term names the terms in problem files"


def term_of_cost(cost: ExtraCost) -> Term:
    """Return an extra cost as a term."""
    return Term(
        words=f"integral of the extra cost '{cost.name}'",
        unit=cost.unit,
        integrand=lambda at: expressed(cost, at),
        size=lambda scales, _: scales.time_s,
        chatters=True,
    )


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Objective:
    """The sum of terms from `TERMS` and of `extra` costs, each with its positive weight per SI unit of the term."""

    weights: Mapping[str, float]
    extra: Sequence[ExtraCost] = ()
    terms: Mapping[str, Term] = field(init=False)

    def __post_init__(self) -> None:
        weights, extra = dict(self.weights), checked_extras(self.extra, ExtraCost, "extra_costs")
        if not weights and not extra:
            raise ProblemError(f"objective.minimize must name at least one of {', '.join(TERMS)}")
        own = {cost.name: cost for cost in extra}
        for term in weights:
            if term not in TERMS and term not in own:
                raise ProblemError(
                    f"objective.minimize must be one of {', '.join(TERMS)}, got '{term}'{nearest(term, TERMS)}"
                )
        for name in own:
            if name in TERMS:
                raise ProblemError(f"extra cost '{name}' has the name of a term of objective.minimize")
        weights |= {name: cost.weight for name, cost in own.items()}
        object.__setattr__(self, "weights", weights)
        object.__setattr__(self, "extra", extra)
        terms = {name: term_of_cost(own[name]) if name in own else TERMS[name] for name in weights}
        object.__setattr__(self, "terms", terms)

    def __reduce__(self) -> tuple:
        return objective_from, (self.weights, self.extra)  # terms are functions, which cannot be pickled

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
