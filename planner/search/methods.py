"""The search for a motion: its methods, and the state that they share.

A method is one way to search for a motion, from its own start or without a solver. It has a condition, a budget and a
function. The function returns a plan, whether its certificate passes or not, or None if it found no motion.
`planner.search.planning` lists the methods and the repairs.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from linkplan.models.deadline import Deadline, OutOfTimeError, check
from linkplan.planner.closed_chain.guess import Guess, first_guess, users_guess
from linkplan.planner.phase_plane.bang_bang_motions import least_time_guess
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import SolverSettings
from linkplan.planner.refinement.case import Iterate, share_gained
from linkplan.planner.refinement.history import recorded
from linkplan.planner.refinement.state import REPORTED_CHANGE
from linkplan.planner.search.least_limit import LeastLimit, least_limit_of_starts, settled_limit
from linkplan.planner.solvers.solve import INVALID, OF_TIME, OUT_OF_TIME
from linkplan.planner.trajectory import Trajectory


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Budget:
    """The budget of a method: iterations of a solve (None: enough for hard problems) and a share of the remaining time."""

    iterations: int | None = None
    share_of_time: float = 1.0

    def of(self, settings: SolverSettings) -> SolverSettings:
        """Return the settings of a solver within this budget."""
        fewer = settings.max_iterations
        if self.iterations is not None:
            fewer = min(self.iterations, fewer or self.iterations)
        return settings.replace(max_iterations=fewer, deadline=settings.deadline.within_share(self.share_of_time))


# Budgets: of a first start, and of later starts. Feasible motions need tens of iterations; no random problem of the tests
# with a plan took more than 150.
FULL_BUDGET, SHORT_BUDGET = Budget(), Budget(iterations=200)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SearchMethod:
    """One way to search for a motion: its condition, its function and its budget."""

    name: str
    run: "Callable[[Search, Budget], Plan | None]"
    budget: Budget
    tried: "Callable[[Search], bool]" = lambda _: True
    shares_time: "Callable[[Search], bool]" = lambda _: False  # whether half of the time is reserved for later methods


@dataclass(frozen=True, eq=False, slots=True)
class KnownMotions:
    """Certified motions, in the order in which they were found, and the plans that are searched only once."""

    motions: list[Trajectory] = field(default_factory=list)
    sought: dict[str, Plan | None] = field(default_factory=dict)

    def add(self, motion: Trajectory) -> None:
        """Add a motion whose certificate passed."""
        self.motions.append(motion)

    def once(self, what: str, look: Callable[[], Plan | None]) -> Plan | None:
        """Return the plan that `look` finds; it is called once for each `what`, and a motion that passes is added."""
        if what not in self.sought:
            plan = look()
            self.sought[what] = plan
            if plan is not None and plan.passed:
                self.add(plan.require_motion("know"))
        return self.sought[what]

    @property
    def least_duration_s(self) -> float | None:
        """The duration of the shortest motion [s]; None without a motion."""
        return min((motion.duration_s for motion in self.motions), default=None)

    def shorter_than(self, duration_s: float) -> list[Trajectory]:
        """Return the motions that take less than a duration [s], the longest first."""
        shorter = [motion for motion in self.motions if motion.duration_s < duration_s]
        return sorted(shorter, key=lambda motion: -motion.duration_s)


@dataclass(frozen=True, eq=False, kw_only=True)
class Search:
    """A search for a motion, as every method sees it.

    `methods` are tried in order, `repairs` on a motion whose certificate does not pass. `problem` is the given one, with the
    deadline of the search; `start_pose` (n_q,) is closed. `plans` are the plans of the methods so far, in order. The phase
    plane's motion, the smooth path and the least factor on the effort limits are computed at their first use.
    """

    problem: Problem
    start_pose: np.ndarray
    methods: Sequence[SearchMethod] = ()
    repairs: Sequence["Repair"] = ()
    plans: list[Plan] = field(default_factory=list)
    verdicts: list[Plan] = field(default_factory=list)  # answers that no further method can change
    known: KnownMotions = field(default_factory=KnownMotions)

    @cached_property
    def quickest(self) -> Guess | None:
        """The phase plane's motion of least time; None if it has none."""
        return least_time_guess(self.problem, self.start_pose)

    @cached_property
    def smooth(self) -> Guess:
        """The smoothest path through start, waypoints and goal."""
        return first_guess(self.problem, self.start_pose)

    @cached_property
    def named_limit(self) -> LeastLimit | None:
        """The least factor on the effort limits; if above 1, computed on meshes fine enough for a message.

        None without a motion.
        """
        problem = self.within(SHORT_BUDGET)
        found = least_limit_of_starts(problem, self.smooth)
        return found if found is None or found.factor <= 1.0 else settled_limit(problem, found)

    def first_starts(self) -> Iterator[tuple[str, Guess]]:
        """Yield the user's guess if it closes the loops, then the smooth path, each with its name."""
        own = users_guess(self.problem, self.start_pose)
        if own is not None:
            yield "the guess given", own
        yield "a smooth path", self.smooth

    def of_another(self, problem: Problem) -> "Search":
        """Return a search for another problem's motion from the same start; it runs inside its own `recording`."""
        return Search(problem=problem, start_pose=self.start_pose, methods=self.methods, repairs=self.repairs)

    def within(self, budget: Budget) -> Problem:
        """Return the problem with solver settings within a budget."""
        return self.problem.varied(solver=budget.of(self.problem.solver))

    @property
    def deadline(self) -> Deadline:
        """The deadline of the search."""
        return self.problem.solver.deadline

    @property
    def only_time_counts(self) -> bool:
        """Whether the objective is time alone."""
        return list(self.problem.objective.weights) == ["time"]

    @property
    def best(self) -> Plan | None:
        """The current answer: a verdict, the cheapest plan that passes, or the first plan; else None.

        Of plans that cost the same, an optimal one is the answer, and of several the last one.
        """
        passed = [plan for plan in reversed(self.plans) if plan.passed]
        least = min((plan.objective for plan in passed if plan.objective is not None), default=None)
        cheap = [
            plan for plan in passed if least is None or plan.objective is None or _costs_as_little(plan.objective, least)
        ]
        cheap.sort(key=lambda plan: plan.status != "optimal")
        return next(iter([*self.verdicts, *cheap, *self.plans]), None)

    @property
    def solved(self) -> bool:
        """Whether a plan passes."""
        return any(plan.passed for plan in self.plans)

    @property
    def starts_are_worth_it(self) -> bool:
        """Whether another start is worth trying: no plan passes, and not too many plans have failed."""
        # After this number of motions that do not pass, no further starts are tried.
        return not self.solved and len(self.plans) < 2

    @property
    def ended(self) -> bool:
        """Whether no further method is tried."""
        return bool(self.verdicts) or self.stopped is not None

    @property
    def stopped(self) -> str | None:
        """The reason why the search stops early (time, or a number that is not finite); None if it continues."""
        # The search stops if less than this time is left [s]: a solver stops a little before or after its limit.
        if self.deadline.left_s < 0.01:
            return OUT_OF_TIME
        steps = recorded()
        if not self.plans and steps and steps[-1].solver_status == INVALID:
            return INVALID
        return None


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Repair:
    """One way to repair a motion whose certificate does not pass: its condition and its function.

    Both take the problem within its budget. `tried` takes the plan so far. `repair` takes the first solution and returns
    another plan, or None.
    """

    name: str
    tried: Callable[[Problem, Plan], bool]
    repair: Callable[[Problem, Iterate], Plan | None]
    always: bool = True  # or only if every repair is tried


def _costs_as_little(objective: float, least: float) -> bool:
    return share_gained(objective, least) <= REPORTED_CHANGE


def run_search(search: Search) -> Plan | None:
    """Return the best plan of its methods, tried in order until the search has ended; None if none found a motion."""
    for method in search.methods:
        check()
        if search.ended:
            break
        with contextlib.suppress(OutOfTimeError):
            if not method.tried(search):
                continue
            half = method.shares_time(search)
            plan = method.run(search, replace(method.budget, share_of_time=0.5) if half else method.budget)
            if plan is not None:
                search.plans.append(plan)
    best = search.best
    if best is None:
        return None
    # The words of a plan without a motion already names the time limit.
    cut = search.stopped == OUT_OF_TIME and best.trajectory is not None
    found = "the best found within" if best.passed else "the search ran out of"
    said = f"{found} its {search.problem.solver.max_time_s:g} s {OF_TIME}" if cut else ""
    best = best.adding(said, out_of_time=best.verdict.out_of_time or cut)
    return replace(best, problem=search.problem, history=recorded())
