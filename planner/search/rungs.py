"""The rungs of a search, and the loop that tries them in order; mechanisms and differential equations share both.

A rung is one way to search for a motion: a start, or a continuation. Each rung has a condition, a budget and one function.
It returns a plan, whether its certificate passes or not, or None if it found no motion.
"""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

from linkplan.models.deadline import OutOfTimeError
from linkplan.models.interrupts import check
from linkplan.planner.problem.settings import SolverSettings


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Budget:
    """The budget of a rung: iterations of each solve (None: as many as hard problems take) and a share of the time left."""

    iterations: int | None = None
    share_of_time: float = 1.0

    def of(self, settings: SolverSettings) -> SolverSettings:
        """Return the settings of a solver within this budget."""
        fewer = settings.max_iterations
        if self.iterations is not None:
            fewer = min(self.iterations, fewer or self.iterations)
        return replace(settings, max_iterations=fewer, deadline=settings.deadline.within_share(self.share_of_time))


# Budgets: of a first start, and of what is tried after it. Feasible motions need tens of iterations: no random problem of
# the tests that led to a plan took more than 150.
PATIENT, HURRIED = Budget(), Budget(iterations=200)


class Climbed(Protocol):
    """The part of a search that the loop over the rungs knows."""

    @property
    def plans(self) -> list[Any]:
        """The plans of the rungs so far, in order."""
        ...

    @property
    def ended(self) -> bool:
        """True if no further rung is tried."""
        ...


SearchT = TypeVar("SearchT", bound=Climbed)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Rung(Generic[SearchT]):
    """One way to search for a motion: its condition, its function and its budget."""

    name: str
    climb: Callable[[SearchT, Budget], Any]
    budget: Budget
    tried: Callable[[SearchT], bool] = lambda _: True


def try_in_turn(search: SearchT, rungs: Sequence[Rung[SearchT]]) -> None:
    """Try the rungs in order until the search has ended, and append their plans to those of the search."""
    for rung in rungs:
        check()
        if search.ended:
            break
        with contextlib.suppress(OutOfTimeError):
            plan = rung.climb(search, rung.budget) if rung.tried(search) else None
            if plan is not None:
                search.plans.append(plan)
