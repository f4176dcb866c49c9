"""What robustness costs: a plan beside that of the machine as modelled, with the whole of its effort limits."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from linkplan.planner.plan import Plan
from linkplan.planner.planning import plan_motion, silent
from linkplan.planner.problem.objective import TERMS
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
        return (
            f"price of robustness: {self.name} {self.objective:.6g}{unit} against {self.nominal:.6g}{unit} of the machine as"
            f" modelled within its whole limits, {100 * self.share:+.3g} %"
        )


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
    objective = plan.problem.objective
    unit = TERMS[objective.name][1] if objective.name in TERMS else ""
    return Price(objective=plan.objective, nominal=cheaper.objective, unit=unit, name=objective.name)
