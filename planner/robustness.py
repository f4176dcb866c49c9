"""What robustness costs: a plan beside that of the machine as modelled, with the whole of its effort limits."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from linkplan.planner.plan import Plan
from linkplan.planner.planning import plan_motion, silent
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.problem.robust import Robust


@dataclass(frozen=True, slots=True, kw_only=True)
class Price:
    """The objective of a plan that keeps a reserve or corners, and of the nominal one, in the objective's unit."""

    objective: float
    nominal: float
    unit: str
    name: str

    @property
    def share(self) -> float:
        """By how much of the nominal objective the plan is dearer."""
        return self.objective / self.nominal - 1 if self.nominal else float("inf")

    def sentence(self) -> str:
        """Return the price in words."""
        unit = f" {self.unit}" if self.unit else ""
        dearer = f"{100 * self.share:+.3g} %" if self.share < _TIMES else f"{1 + self.share:.3g} times as much"
        return (
            f"price of robustness: {self.name} {self.objective:.6g}{unit} against {self.nominal:.6g}{unit} of the machine as"
            f" modelled within its whole limits, {dearer}"
        )


# From this share on, a price is said as a factor.
_TIMES = 2.0
# The nominal plan's objective among a plan's details, in the objective's SI unit.
_DETAIL = "objective_as_modelled"


def nominal_of(problem: PlanningProblem) -> PlanningProblem | None:
    """Return a problem without its ranges and its reserve; None where it has neither."""
    limits = problem.limits
    if not problem.robust.corners and not limits.reserve:
        return None
    source = {section: table for section, table in problem.source.items() if section != "robust"}
    return replace(
        problem, robust=Robust(), limits=replace(limits, effort=limits.actuators_effort, reserve=0.0), source=source
    )


def price_of(plan: Plan, say: Callable[[str], None] = silent) -> Price | None:
    """Return what a plan's ranges and reserve cost; None where it has none, or one of the two plans has no motion."""
    nominal = nominal_of(plan.problem) if plan.trajectory is not None else None
    if nominal is None:
        return None
    say("the machine as modelled, for the price")
    cheaper = plan_motion(nominal, say)
    if cheaper.trajectory is None or cheaper.objective is None or plan.objective is None:
        return None
    # The plan itself is a motion of the machine as modelled: no nominal optimum is dearer, whatever a local search found.
    return _price(plan, min(cheaper.objective, plan.objective))


def with_price(plan: Plan, price: Price | None) -> Plan:
    """Return a plan whose details, which are saved with it, have its price."""
    return plan if price is None else replace(plan, details={**plan.details, _DETAIL: price.nominal})


def saved_price(plan: Plan) -> Price | None:
    """Return the price that a plan's details have; None where they have none."""
    nominal = plan.details.get(_DETAIL)
    if plan.objective is None or not isinstance(nominal, int | float):
        return None
    return _price(plan, float(nominal))


def _price(plan: Plan, nominal: float) -> Price:
    objective = plan.problem.objective
    return Price(objective=plan.objective, nominal=nominal, unit=objective.unit, name=objective.name)
