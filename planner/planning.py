"""From a planning problem to a certified plan: a sequence of attempts, then the reason if none gives a motion.

The three tables below are the whole strategy, in order. A rung is tried if its condition holds, within its budget. The first
plan that passes ends the search, unless the phase plane knows a motion that may be better. Repairs are applied to a motion
whose certificate fails, before the next rung. Diagnoses give the reason why there is no motion, and never return one. A new
rung is one function, `(Search, Budget) -> Plan | None`, and one row.
"""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace

from linkplan.models.deadline import OutOfTimeError
from linkplan.models.one_thread import one_thread_at_a_time
from linkplan.planner.closed_chain.answer import LOCALLY, plan_prescribed
from linkplan.planner.diagnosis import reasons
from linkplan.planner.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.history import Say, progress, recorded, recording, silent
from linkplan.planner.search import attempts, continuations, margins, starts, waiting
from linkplan.planner.search.ladder import Repair, Search, climb
from linkplan.planner.search.rungs import HURRIED, PATIENT, Budget, Rung
from linkplan.planner.search.smooth_path import along_smooth_path
from linkplan.planner.solvers.solve import OUT_OF_TIME, why_stopped

__all__ = ["DIAGNOSES", "REPAIRS", "RUNGS", "Say", "plan_motion", "silent"]


Climb = Callable[[Search, Budget], Plan | None]


def _with_time_to_wait(start: Climb) -> Climb:
    """Return an attempt limited to a quarter of the time left, if several driven freedoms may wait.

    The first start of a swing-up may otherwise use up all the time in refinement.
    """

    def climb(search: Search, budget: Budget) -> Plan | None:
        spare = search.problem.mechanism.dof > 1 and waiting.may_wait(search)
        return start(search, replace(budget, share_of_time=0.25) if spare else budget)

    return climb


def _first_starts(search: Search, budget: Budget) -> Plan | None:
    """Return the plan of the first starts: of as many as the problem asks for, or of the given guess and the smooth path."""
    several = search.problem.solver.starts > 1
    return (starts.best_of_several if several else _with_time_to_wait(starts.from_first_starts))(search, budget)


_FIRST: tuple[Rung, ...] = (
    Rung(
        name="the guess given, then a smooth path; or the best of several starts (multistart)",
        tried=lambda search: search.problem.solver.starts > 1 or starts.one_start_is_worth_it(search),
        climb=_first_starts,
        budget=PATIENT,
    ),
    Rung(
        name="the phase plane: dynamic programming, then bang efforts",
        tried=starts.phase_plane_may_help,
        climb=starts.from_the_phase_plane,
        budget=HURRIED,
    ),
)
_SWINGS = Rung(
    name="swings",
    tried=lambda search: starts.one_start_is_worth_it(search) and not starts.no_time(search),
    climb=_with_time_to_wait(starts.from_swings),
    budget=HURRIED,
)
_LONGER = Rung(
    name="continuation in the duration",
    tried=lambda search: (
        not search.solved
        and all(attempts.unsound(plan) for plan in search.plans[:1])
        and not search.only_time_counts
        and continuations.may_be_lengthened(search)
        and not waiting.far_beyond(search)
    ),
    climb=continuations.from_continuation,
    budget=PATIENT,
)

RUNGS: tuple[Rung, ...] = (
    Rung(
        name="the phase plane along limits on power and pin force",
        tried=starts.is_along_power,
        climb=starts.along_power,
        budget=HURRIED,
    ),
    *_FIRST,
    Rung(
        name="at a distance from singular poses",
        tried=margins.may_near_singular,
        climb=lambda search, budget: margins.at_a_distance(search, budget, (*_FIRST, _SWINGS, _LONGER)),
        budget=PATIENT,
    ),
    _SWINGS,
    _LONGER,
    Rung(
        name="the least time, and waiting",
        tried=lambda search: not search.solved and waiting.may_wait(search),
        climb=waiting.from_waiting,
        budget=PATIENT,
    ),
)

REPAIRS: tuple[Repair, ...] = (
    Repair(
        name="limits on power and pin force kept at every instant",
        tried=attempts.may_be_enclosed,
        mend=attempts.enclosed,
    ),
    Repair(
        name="finer meshes begun next to the coarser one's answer",
        tried=lambda _problem, plan: attempts.unsound(plan),
        mend=attempts.from_next_to_it,
        always=False,
    ),
)

Diagnosis = Callable[[Search], Plan | None]
# In this order: the first diagnosis that applies gives the reason.
DIAGNOSES: tuple[Diagnosis, ...] = (
    reasons.solver_stopped,
    reasons.one_limit,
    reasons.efforts_contradicted,
    reasons.efforts_without_proof,
    reasons.efforts,
    reasons.efforts_without_other_limits,
    reasons.ranges,
    reasons.efforts_by_the_phase_plane,
    reasons.nothing_found,
)


@one_thread_at_a_time
def plan_motion(
    problem: Problem, say: Say = silent, rungs: Sequence[Rung] = RUNGS, diagnoses: Sequence[Diagnosis] = DIAGNOSES
) -> Plan:
    """Return the plan of a problem; `message` gives the reason if it has no motion.

    Args:
        problem: the problem; `solver.max_time_s` limits the whole of planning.
        say: called with a line of progress from time to time.
        rungs: the attempts, in order.
        diagnoses: the searches for the reason why there is no motion, in order; the last one has a reason for every problem.

    Raises:
        ProblemError: when start, goal or reference contradict the mechanism.
    """
    begun, plans = replace(problem, solver=problem.solver.begun()), []
    with recording(_with_the_best(say, plans)):
        try:
            plan = _planned(begun, rungs, diagnoses, plans)
        except OutOfTimeError:
            message = f"failed: {why_stopped(OUT_OF_TIME, problem.solver.max_time_s)}"
            plan = Plan(problem=problem, status="failed", message=message, history=recorded())
    return replace(plan, problem=problem)


def _planned(problem: Problem, rungs: Sequence[Rung], diagnoses: Sequence[Diagnosis], plans: list[Plan]) -> Plan:
    """Return the plan of a problem with a deadline; plans of the rungs are appended to `plans`.

    Raises:
        OutOfTimeError: when the deadline passes before anything is known.
    """
    start_pose = problem.start_pose()
    if problem.motion.kind == "track":
        return plan_prescribed(problem, start_pose)
    search = Search(problem=problem, start_pose=start_pose, repairs=REPAIRS, plans=plans)
    excluded = reasons.contradicted(search) or reasons.too_short(search)
    return excluded or _climbed_or_smooth(search, rungs) or _diagnosed(search, diagnoses)


def _climbed_or_smooth(search: Search, rungs: Sequence[Rung]) -> Plan | None:
    """Return the plan of the rungs; if it does not pass, the smooth path itself if that does; or None."""
    plan = _climbed(search, rungs)
    if plan is not None and plan.passed:
        return plan
    with contextlib.suppress(OutOfTimeError):
        plan = along_smooth_path(search) or plan
    return plan


def _climbed(search: Search, rungs: Sequence[Rung]) -> Plan | None:
    """Return the plan of the rungs, or None; its message says "locally optimal" unless the phase plane proves more."""
    plan = climb(search, rungs)
    if plan is None or plan.status != "optimal" or not starts.judged_by_the_phase_plane(search)[0]:
        return plan
    return replace(plan, message=plan.message.removeprefix(LOCALLY))


def _with_the_best(say: Say, plans: Sequence[Plan]) -> Say:
    """Return a progress function that appends the objective of the best passing plan so far."""

    def say_with_best(text: str) -> None:
        passed = [plan.objective for plan in plans if plan.passed and plan.objective is not None]
        say(f"{text}; best certified {min(passed):.6g}" if passed else text)

    return say_with_best


def _diagnosed(search: Search, diagnoses: Sequence[Diagnosis]) -> Plan:
    """Return the plan with the reason why no motion was found."""
    progress("no motion found; looking for the limit that forbids one")
    return next(plan for diagnosis in diagnoses if (plan := diagnosis(search)) is not None)
