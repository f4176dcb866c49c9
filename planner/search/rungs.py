"""The rungs of a search, and the continuation along a parameter: mechanisms and differential equations share both.

A rung is one way to search for a motion: a start, or a continuation. Each rung has a condition, a budget and one function.
It returns a plan, whether its certificate passes or not, or None if it found no motion.

Continuation follows motions along a parameter, each the start of the next: motions of ever longer duration, of ever smaller
margins to singular poses, and under ever lower limits. A step that is lost is tried again with the root of its factor
(step-length control: Allgower & Georg, Introduction to Numerical Continuation Methods, SIAM 2003, chapter 6).
"""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from linkplan.models.deadline import OutOfTimeError, check
from linkplan.planner.problem.settings import SolverSettings

Stage = TypeVar("Stage")


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


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Path(Generic[Stage]):
    """The stages that were passed, in order; `arrived`: whether the parameter's end was reached, or far enough."""

    stages: tuple[Stage, ...]
    arrived: bool


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Steps:
    """How a parameter is changed: from `begin` towards `end`, by a `factor` at a time.

    A lost step is tried again with the root of the factor, `halvings` times at most.
    """

    begin: float
    end: float
    factor: float
    halvings: int


def followed(
    stage: Stage,
    steps: Steps,
    solve: Callable[[Stage, float], Stage | None],
    *,
    enough: Callable[[Stage, Stage, bool], bool] = lambda _before, _after, _whole: False,
    after_loss: Callable[[Stage], Stage] = lambda stage: stage,
) -> Path[Stage]:
    """Return the stages along a parameter.

    Args:
        stage: at the beginning.
        steps: of the parameter.
        solve: returns the next stage from one and the parameter's next value; None where it is lost.
        enough: whether to end, from a stage, the next, and whether the step between them was a whole one.
        after_loss: returns the stage from which a lost step is tried again.
    """
    stages, value, factor, halvings = [stage], steps.begin, steps.factor, steps.halvings
    way = np.sign(np.log(steps.factor))
    for _ in range(40):  # the end may be infinite or far away
        # The relative distance at which a parameter counts as at its end: rounding.
        if way * (steps.end * (1 - way * 1e-12) - value) <= 0:
            return Path(stages=tuple(stages), arrived=True)
        following = float(way * min(way * value * factor, way * steps.end))
        found = solve(stages[-1], following)
        if found is None:
            if not halvings:
                return Path(stages=tuple(stages), arrived=False)
            factor, halvings = float(np.sqrt(factor)), halvings - 1
            stages[-1] = after_loss(stages[-1])
            continue
        stages.append(found)
        if enough(stages[-2], found, factor == steps.factor):
            return Path(stages=tuple(stages), arrived=True)
        value = following
    return Path(stages=tuple(stages), arrived=False)
