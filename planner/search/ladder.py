"""The ladder: what the rungs of a search share, and how they are climbed in order.

A rung is one way of looking for a motion: a start, or a continuation. Each has a condition, a budget and one function; the
table of them stands in `planner.planning`. A rung returns a plan, passed or missed, or None where it found no motion.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from linkplan.models.deadline import Deadline, OutOfTimeError
from linkplan.models.interrupts import check
from linkplan.planner.closed_chain.guess import Guess, first_guess, users_guess
from linkplan.planner.phase_plane.bang_bang_motions import least_time_guess
from linkplan.planner.plan import Plan
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.problem.settings import SolverSettings
from linkplan.planner.refinement.history import recorded
from linkplan.planner.search.least_limit import LeastLimit, least_limit_of_starts, settled_limit
from linkplan.planner.search.solving import Iterate
from linkplan.planner.solvers.outcome import INVALID, OF_TIME, OUT_OF_TIME

# So little of a search's time [s] is none: a solver that stops at its limit stops a hair before or after it.
_NO_TIME_S = 0.01
# Motions that were found and do not pass: after so many, further starts will not lead to one that does.
_MOST_MISSED = 2


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Budget:
    """What a rung may spend: iterations of each solve (None: as many as a hard problem takes), a share of the time left."""

    iterations: int | None = None
    share_of_time: float = 1.0

    def of(self, settings: SolverSettings) -> SolverSettings:
        """Return the settings of a solver within this budget."""
        fewer = settings.max_iterations
        if self.iterations is not None:
            fewer = min(self.iterations, fewer or self.iterations)
        return replace(settings, max_iterations=fewer, deadline=settings.deadline.within_share(self.share_of_time))


@dataclass(frozen=True, eq=False, kw_only=True)
class Search:
    """A search for a motion, as every rung sees it.

    `problem` is as it was asked, with the deadline of the search; `start_pose` (n_q,) is closed. `history` notes every
    solve, `plans` every plan that a rung came to, in order. What is computed once for all rungs is computed when it is first
    asked for: the phase plane's motion, the smooth path, the least factor on the effort limits.
    """

    problem: PlanningProblem
    start_pose: np.ndarray
    repairs: Sequence["Repair"] = ()
    plans: list[Plan] = field(default_factory=list)
    verdicts: list[Plan] = field(default_factory=list)  # answers that no further rung would change
    # The plan of least time, once it was looked for: from the phase plane's motion, and by the first rungs of the ladder.
    least_times: list[Plan | None] = field(default_factory=list)
    shortest: list[Plan | None] = field(default_factory=list)

    @cached_property
    def quickest(self) -> Guess | None:
        """The motion of least time that the phase plane knows; None where it knows of none."""
        return least_time_guess(self.problem, self.start_pose)

    @cached_property
    def smooth(self) -> Guess:
        """The smoothest path through start, waypoints and goal."""
        return first_guess(self.problem, self.start_pose)

    @cached_property
    def least_limit(self) -> LeastLimit | None:
        """The least factor on the effort limits with which a motion was found; None where none was."""
        return least_limit_of_starts(self.within(Budget(iterations=HURRIED.iterations)), self.smooth)

    @cached_property
    def named_limit(self) -> LeastLimit | None:
        """The least factor on the effort limits, on meshes fine enough to be named; None where none was found."""
        found = self.least_limit
        if found is None or found.factor <= 1.0:
            return found
        return settled_limit(self.within(Budget(iterations=HURRIED.iterations)), found)

    def first_starts(self) -> Iterator[tuple[str, Guess]]:
        """Yield the user's own guess where it closes the loops, then the smooth path, with a word on each."""
        own = users_guess(self.problem, self.start_pose)
        if own is not None:
            yield "the guess given", own
        yield "a smooth path", self.smooth

    def of_another(self, problem: PlanningProblem) -> "Search":
        """Return a search for another problem's motion from the same start; it is climbed inside its own `recording`."""
        return Search(problem=problem, start_pose=self.start_pose, repairs=self.repairs)

    def within(self, budget: Budget) -> PlanningProblem:
        """Return the problem with the settings that a budget allows its solves."""
        return replace(self.problem, solver=budget.of(self.problem.solver))

    @property
    def deadline(self) -> Deadline:
        """When the search is to be done."""
        return self.problem.solver.deadline

    @property
    def only_time_counts(self) -> bool:
        """Whether the objective is time alone."""
        return list(self.problem.objective.weights) == ["time"]

    @property
    def best(self) -> Plan | None:
        """The answer so far: a verdict, the last plan that is optimal, or feasible, else the first; None without any."""
        passed = sorted((plan for plan in reversed(self.plans) if plan.passed), key=lambda plan: plan.status != "optimal")
        return next(iter([*self.verdicts, *passed, *self.plans]), None)

    @property
    def solved(self) -> bool:
        """Whether a plan passes."""
        return any(plan.passed for plan in self.plans)

    @property
    def missed(self) -> bool:
        """Whether motions were found and none passes."""
        return bool(self.plans) and not self.solved

    @property
    def starts_are_worth_it(self) -> bool:
        """Whether a further start may lead to a motion: none passes, and not too many were found that do not."""
        return not self.solved and len(self.plans) < _MOST_MISSED

    @property
    def stopped(self) -> str | None:
        """The solver's word where nothing more is to be had of it: time is up, or a number is not finite; None elsewhere."""
        if self.deadline.left_s < _NO_TIME_S:
            return OUT_OF_TIME
        steps = recorded()
        if not self.plans and steps and steps[-1].solver_status == INVALID:
            return INVALID
        return None


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Rung:
    """One way of looking for a motion: when it is tried, by which function, and what that may spend."""

    name: str
    climb: Callable[[Search, Budget], Plan | None]
    budget: Budget
    tried: Callable[[Search], bool] = lambda _: True


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Repair:
    """One way of mending a motion whose certificate does not pass: when it is tried, and by which function.

    Both take the problem within its budget, `tried` the plan so far, `mend` the first solution: it returns another plan, or
    None where it found none.
    """

    name: str
    tried: Callable[[PlanningProblem, Plan], bool]
    mend: Callable[[PlanningProblem, Iterate], Plan | None]
    always: bool = True  # or only for motions that are worth every repair


# Budgets: of a first start, and of what is tried after it. A motion that exists is found in tens of iterations; none of the
# random problems of the tests took more than 150 where it led to a plan.
PATIENT, HURRIED = Budget(), Budget(iterations=200)


def climb(search: Search, rungs: Sequence[Rung]) -> Plan | None:
    """Return the best plan that the rungs lead to, tried in their order; None where none found a motion."""
    for rung in rungs:
        check()
        if search.verdicts or search.stopped:
            break
        with contextlib.suppress(OutOfTimeError):
            plan = rung.climb(search, rung.budget) if rung.tried(search) else None
            if plan is not None:
                search.plans.append(plan)
    best = search.best
    if best is None:
        return None
    cut = search.stopped == OUT_OF_TIME and best.trajectory is not None  # without a motion the message says so already
    found = "the best found within" if best.passed else "the search ran out of"
    said = f"; {found} its {search.problem.solver.max_time_s:g} s {OF_TIME}" if cut else ""
    return replace(best, problem=search.problem, history=recorded(), message=best.message + said)
