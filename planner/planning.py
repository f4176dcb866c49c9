"""From a planning problem to a certified plan: the ladder of attempts, and the reason where none leads to a motion.

The three tables below are the whole strategy, in order. A rung is tried where its condition holds, within its budget; the
first plan that passes ends the search, but for a least time that the phase plane knows to be a local one. Repairs mend a
motion whose certificate does not pass, before the next rung. Diagnoses say why there is no motion, and never return one.
To add a rung: one function, `(Search, Budget) -> Plan | None`, and one row.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from linkplan.models.deadline import OutOfTimeError
from linkplan.planner.closed_chain.prescribed_plan import plan_prescribed
from linkplan.planner.diagnosis import reasons
from linkplan.planner.plan import Plan
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.refinement.history import Say, progress, recorded, recording, silent
from linkplan.planner.search import attempts, duration_continuation, effort_continuation, starts, waiting
from linkplan.planner.search.ladder import HURRIED, PATIENT, Budget, Repair, Rung, Search, climb
from linkplan.planner.search.presolve import start_pose_of
from linkplan.planner.solvers.outcome import OUT_OF_TIME, why_stopped

__all__ = ["DIAGNOSES", "REPAIRS", "RUNGS", "Say", "plan_motion", "silent"]


# The share of the time left that such a start may take: a swing-up's first start is refined without end.
_SPARING = 0.25
Climb = Callable[[Search, Budget], Plan | None]


def _sparing(start: Climb) -> Climb:
    """Return a way of looking for a motion that leaves time for rest, where several driven freedoms may wait."""

    def climb(search: Search, budget: Budget) -> Plan | None:
        spare = search.problem.mechanism.dof > 1 and waiting.may_wait(search)
        return start(search, replace(budget, share_of_time=_SPARING) if spare else budget)

    return climb


def _nothing_found(search: Search) -> bool:
    return not search.plans and not starts.far_too_little_time(search)


RUNGS: tuple[Rung, ...] = (
    Rung(
        name="the phase plane along limits on power and pin force, its arcs held",
        tried=starts.is_along_power,
        climb=starts.along_power,
        budget=HURRIED,
    ),
    Rung(
        name="several starts, the best of them (multistart)",
        tried=lambda search: search.problem.solver.starts > 1,
        climb=starts.best_of_several,
        budget=PATIENT,
    ),
    Rung(
        name="the guess given, then a smooth path",
        tried=starts.one_start_is_worth_it,
        climb=_sparing(starts.from_first_starts),
        budget=PATIENT,
    ),
    Rung(
        name="the phase plane, its bang efforts fixed",
        tried=starts.phase_plane_may_help,
        climb=starts.from_the_phase_plane,
        budget=HURRIED,
    ),
    Rung(
        name="swings",
        tried=lambda search: starts.one_start_is_worth_it(search) and not starts.no_time(search),
        climb=_sparing(starts.from_swings),
        budget=HURRIED,
    ),
    Rung(
        name="continuation in the duration",
        tried=lambda search: (
            not search.solved
            and all(attempts.unsound(plan) for plan in search.plans[:1])
            and not search.only_time_counts
            and duration_continuation.may_be_lengthened(search)
            and not waiting.far_beyond(search)
        ),
        climb=duration_continuation.from_continuation,
        budget=PATIENT,
    ),
    Rung(
        name="the least time, and waiting",
        tried=lambda search: not search.solved and waiting.may_wait(search),
        climb=waiting.from_waiting,
        budget=PATIENT,
    ),
    Rung(
        name="continuation in the effort limits",
        tried=lambda search: _nothing_found(search) and effort_continuation.efforts_suffice(search),
        climb=effort_continuation.from_least_peak_effort,
        budget=HURRIED,
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
    Repair(
        name="efforts constant over intervals",
        tried=attempts.constant_efforts_would_do,
        mend=attempts.with_constant_efforts,
    ),
)

# In this order: the first that answers is the reason.
DIAGNOSES = (
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


def plan_motion(problem: PlanningProblem, say: Say = silent, rungs: Sequence[Rung] = RUNGS) -> Plan:
    """Return the plan of a problem; one without an answer says why in `message`.

    Args:
        problem: what to plan; `solver.max_time_s` bounds the whole of it.
        say: called with a line of progress now and then.
        rungs: ways of looking for a motion, in order.

    Raises:
        ProblemError: when start, goal or reference contradict the mechanism itself.
    """
    begun, plans = replace(problem, solver=problem.solver.begun()), []
    with recording(_with_the_best(say, plans)):
        try:
            plan = _planned(begun, rungs, plans)
        except OutOfTimeError:
            message = f"failed: {why_stopped(OUT_OF_TIME, problem.solver.max_time_s)}"
            plan = Plan(problem=problem, status="failed", message=message, history=recorded())
    return replace(plan, problem=problem)


def _planned(problem: PlanningProblem, rungs: Sequence[Rung], plans: list[Plan]) -> Plan:
    """Return the plan of a problem with a deadline; `plans` takes those that the rungs lead to.

    Raises:
        OutOfTimeError: when the deadline passes before anything is known.
    """
    start_pose = start_pose_of(problem)
    if problem.motion.kind == "track":
        return plan_prescribed(problem, start_pose)
    search = Search(problem=problem, start_pose=start_pose, repairs=REPAIRS, plans=plans)
    return reasons.contradicted(search) or reasons.too_short(search) or climb(search, rungs) or _diagnosed(search)


def _with_the_best(say: Say, plans: Sequence[Plan]) -> Say:
    """Return progress that ends in the objective of the best of the plans so far that pass, where there is one."""

    def told(text: str) -> None:
        passed = [plan.objective for plan in plans if plan.passed and plan.objective is not None]
        say(f"{text}; best certified {min(passed):.6g}" if passed else text)

    return told


def _diagnosed(search: Search) -> Plan:
    """Return the plan that says why no motion was found."""
    progress("no motion found; looking for the limit that forbids one")
    return next(plan for diagnosis in DIAGNOSES if (plan := diagnosis(search)) is not None)
