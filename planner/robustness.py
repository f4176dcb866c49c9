"""The price of robustness: a plan's objective compared with that of the nominal machine within its full effort limits."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from linkplan.planner.plan import Plan
from linkplan.planner.planning import plan_motion, silent
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.robust import Robust


@dataclass(frozen=True, slots=True, kw_only=True)
class Price:
    """The objectives of a plan with a reserve or corners and of the nominal plan, in the objective's unit."""

    objective: float
    nominal: float
    unit: str
    name: str

    @property
    def share(self) -> float:
        """The relative increase of the objective over the nominal one."""
        return self.objective / self.nominal - 1 if self.nominal else float("inf")

    def sentence(self) -> str:
        """Return the price as a sentence."""
        unit = f" {self.unit}" if self.unit else ""
        dearer = f"{100 * self.share:+.3g} %" if self.share < 2.0 else f"{1 + self.share:.3g} times as much"
        return (
            f"price of robustness: {self.name} {self.objective:.6g}{unit} against {self.nominal:.6g}{unit} of the machine as"
            f" modelled within its whole limits, {dearer}"
        )


# The key of the nominal plan's objective in a plan's details, in the objective's SI unit.
_DETAIL = "objective_as_modelled"


def nominal_of(problem: Problem) -> Problem | None:
    """Return a problem without its ranges and its reserve; None if it has neither."""
    limits = problem.limits
    if not problem.robust.corners and not limits.reserve:
        return None
    source = {section: table for section, table in problem.source.items() if section != "robust"}
    return replace(
        problem, robust=Robust(), limits=replace(limits, effort=limits.actuators_effort, reserve=0.0), source=source
    )


def price_of(plan: Plan, say: Callable[[str], None] = silent) -> Price | None:
    """Return the price of a plan's ranges and reserve; None if it has none, or one of the two plans has no motion."""
    nominal = nominal_of(plan.problem) if plan.trajectory is not None else None
    if nominal is None:
        return None
    say("the machine as modelled, for the price")
    cheaper = plan_motion(nominal, say)
    if cheaper.trajectory is None or cheaper.objective is None or plan.objective is None:
        return None
    # The plan itself is a motion of the nominal machine, so the nominal optimum cannot be dearer.
    return _price(plan, min(cheaper.objective, plan.objective))


def with_price(plan: Plan, price: Price | None) -> Plan:
    """Return a plan with its price in the details, which are saved."""
    return plan if price is None else replace(plan, details={**plan.details, _DETAIL: price.nominal})


def saved_price(plan: Plan) -> Price | None:
    """Return the price in a plan's details; None if there is none."""
    nominal = plan.details.get(_DETAIL)
    if plan.objective is None or not isinstance(nominal, int | float):
        return None
    return _price(plan, float(nominal))


def _price(plan: Plan, nominal: float) -> Price:
    objective = plan.problem.objective
    assert plan.objective is not None  # that of a motion that passes
    return Price(objective=plan.objective, nominal=nominal, unit=objective.unit, name=objective.name)
