"""A first solution of a user's problem, before it is refined."""

from dataclasses import dataclass

from linkplan.planner.ode.case import OdeCase
from linkplan.planner.ode.trajectory import OdeTrajectory
from linkplan.planner.refinement.case import Iterate


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class FirstSolution:
    """A first solution, the case that it solves, and the number of its start.

    `away` has the words on a duration that has no best, where there is none.
    """

    case: OdeCase
    found: Iterate[OdeTrajectory]
    number: int = 0
    away: str | None = None
