"""The search for fast motions of several motors: cheap first solves, the best few refined, every certified motion a bound.

A first solve takes tens of iterations once three things hold: its iterates keep a distance from singular poses, a small
weight on efforts breaks the ties of joints with time to spare, and the barrier of every other one of a free duration follows
the iterates. Several local optima exist, and no start leads to the best of them for certain. Starts are therefore tried
until the best objective was found twice; Boender & Rinnooy Kan, Mathematical Programming 37, 1987, have such stopping rules.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.deadline import Deadline, OutOfTimeError
from linkplan.planner.certificate.further_checks import objective_value
from linkplan.planner.closed_chain.case import MechanismCase, case_of
from linkplan.planner.closed_chain.formulate import FIRST_TIE_WEIGHT, TIE_WEIGHT, tie_weights
from linkplan.planner.closed_chain.guess import Guess, closes, guess_from, perturbed_guesses, stretched
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.case import Iterate, attempt, share_gained
from linkplan.planner.refinement.history import progress
from linkplan.planner.search.attempts import certified, objective_of, only_feasible, without_solving
from linkplan.planner.search.finer_meshes import FIRST_MARGIN, LAST_MARGIN, at_a_distance, is_sound
from linkplan.planner.search.ladder import Budget, Search
from linkplan.planner.search.solving import first_mesh, with_longer_durations
from linkplan.planner.search.without_solver import slower

# A first solve takes at most so many iterations.
FIRST_ITERATIONS = 200
# At least and at most so many first solves that lead to a motion, and so many starts in all.
_FEWEST_FOUND, _MOST_FOUND, _MOST_STARTS = 2, 6, 10
# Once one has led to a motion, they take at most this share of the time: what is left is for the best one's refinement.
_SHARE_OF_FIRST = 1.0 / 3.0
# Objectives of first solves that are no further apart than this share are of one motion.
_ALIKE_SHARE = 1e-3
# So many of the best motions are refined.
_MOST_REFINED = 3
# The factors on the duration of a motion that does not pass, in which one of little effort is sought.
_SLOWER_FACTORS = (1.05, 1.3)
_TIES = f"; ties between the joints with time to spare are broken by a weight of {TIE_WEIGHT:g} on squared efforts"
# The factors on the duration of the smooth path from which a free duration is sought.
_STRETCH_FACTORS = (0.7, 1.5, 1.0)


@dataclass(frozen=True, eq=False, slots=True)
class _First:
    """A first solution, the words on its start, and its objective without the weight that breaks ties."""

    what: str
    found: Iterate
    objective: float


def from_several_starts(search: Search, budget: Budget) -> Plan | None:
    """Return the best plan that passes of several starts, else the first that was found; None without a motion."""
    problem = search.within(budget)
    firsts = _first_solutions(search, problem)
    plans: list[Plan] = []
    for first in search.deadline.take(firsts[:_MOST_REFINED]):
        best = _best(plans)
        if best is not None and not _cheaper(first.objective, best):
            break
        progress(f"refining the motion from {first.what}")
        found, unbounded = with_longer_durations(problem, first.found)
        if unbounded is not None:
            search.verdicts.append(Plan(problem=search.problem, status="failed", message=unbounded))
            return None
        plans.append(certified(problem, found))
        if plans[-1].passed:
            break
    best = _best([plan for plan in plans if is_sound(plan.certificate)])
    if best is None and problem.motion.duration_s is None:
        known = [plan.trajectory for plan in plans if plan.trajectory is not None]
        a_little = slower(problem, [*known, *(first.found.motion for first in firsts[:1])])
        if a_little is not None:
            return a_little
    best = best or _best(plans) or (_in_more_time(search.problem, firsts[0]) if firsts else None)
    if best is None:
        return plans[0] if plans else None
    better = min(first.objective for first in firsts)
    if not (plans and best is plans[0]) and _cheaper(better, best):
        return only_feasible(best, f"; a motion with {better:.6g} was found that does not pass its certificate")
    said = _TIES if np.any(tie_weights(problem, TIE_WEIGHT)) else ""
    return replace(best, message=best.message + said + _margin_kept(problem, best))


def _margin_kept(problem: Problem, plan: Plan) -> str:
    """Return the words on a distance from singular poses that nobody asked for and that the motion meets, or none."""
    ratio = plan.certificate.singularity_ratio if plan.certificate is not None else np.inf
    met = [margin for margin in (FIRST_MARGIN, LAST_MARGIN) if 0.9 * margin <= ratio <= 1.02 * margin]
    if not met or met[0] <= problem.limits.singular_margin:
        return ""
    return f"; it keeps a distance from singular poses, {met[0]:g} of that at home; a motion nearer to them may cost less"


def _in_more_time(problem: Problem, first: _First) -> Plan | None:
    """Return the plan of a motion of little effort in more time, which bounds a free duration's cost; None without one."""
    if problem.motion.duration_s is not None:
        return None
    motion = first.found.motion
    for factor in _SLOWER_FACTORS:
        duration = factor * motion.duration_s
        if duration > (problem.motion.max_duration_s or np.inf):
            break
        fixed = replace(problem.motion, duration_s=duration, min_duration_s=None, max_duration_s=None)
        asked = replace(problem, objective="effort", motion=fixed)
        case, guess = _first_case(asked, motion.start_pose), stretched(guess_from(motion), duration)
        found = attempt(case, guess, *first_mesh(case.problem, guess), f"{factor:g} times slower", adaptive=True)
        plan = None if found is None else certified(asked, found)
        if plan is not None and plan.passed:
            found = plan.require_motion("bound the duration with")
            late = replace(problem, solver=problem.solver.replace(deadline=problem.solver.judging_deadline))
            bound = without_solving(late, found, objective_value(problem, found)[0], f"motion of {duration:.6g} s")
            return bound if is_sound(bound.certificate) else slower(problem, [found])
    return None


def _best(plans: list[Plan]) -> Plan | None:
    """Return the plan that passes with the least objective."""
    passed = [(plan.objective, k) for k, plan in enumerate(plans) if plan.passed and plan.objective is not None]
    return plans[min(passed)[1]] if passed else None


def _first_solutions(search: Search, problem: Problem) -> list[_First]:
    """Return the first solutions of different motions, the best first, until the best one was found twice."""
    case = _first_case(problem, search.start_pose)
    found: list[_First] = []
    after_first = search.deadline.within_share(_SHARE_OF_FIRST)
    for number, (what, guess) in enumerate(search.deadline.take(itertools.islice(_starts(search, problem), _MOST_STARTS))):
        mesh, durations = first_mesh(case.problem, guess)
        if found and after_first.passed:
            break
        try:
            if not closes(problem, guess):
                continue
            adaptive = number % 2 == 0 and problem.motion.duration_s is None
            timed = _in_time(case, found, after_first)
            one = attempt(timed, guess, mesh, durations, f"start from {what}", adaptive=adaptive)
        except OutOfTimeError:
            break
        if one is not None:
            found.append(_First(what, one, objective_of(one)))
        best = min((first.objective for first in found), default=np.inf)
        twice = sum(_alike(first.objective, best) for first in found) > 1
        if len(found) >= _MOST_FOUND or (len(found) >= _FEWEST_FOUND and twice):
            break
    different: list[_First] = []
    for first in sorted(found, key=lambda first: first.objective):
        if not different or not _alike(first.objective, different[-1].objective):
            different.append(first)
    return different


def _in_time(case: MechanismCase, found: list[_First], after_first: Deadline) -> MechanismCase:
    """Return a case whose solve takes at most three times the iterations of the shortest one that led to a motion.

    Without a motion the case is unchanged. After the first motion, a solve must end by the deadline `after_first`.
    """
    if not found:
        return case
    solver = case.problem.solver.replace(deadline=after_first)
    most = 3 * min(first.found.solution.iterations for first in found)
    solver = solver.replace(max_iterations=min(most, solver.max_iterations or most))
    return replace(case, problem=replace(case.problem, solver=solver))


def _cheaper(objective: float, plan: Plan) -> bool:
    """True if an objective is so much less than a plan's that it is of another motion."""
    assert plan.objective is not None
    return share_gained(plan.objective, objective) > _ALIKE_SHARE


def _alike(one: float, other: float) -> bool:
    return abs(share_gained(one, other)) <= _ALIKE_SHARE


def _starts(search: Search, problem: Problem) -> Iterator[tuple[str, Guess]]:
    """Yield starts with the words on each: the user's guess, the smooth path in several durations, perturbed paths."""
    first = list(search.first_starts())
    yield from first[:-1]
    words, smooth = first[-1]
    perturbed = perturbed_guesses(problem, search.start_pose)
    if problem.motion.duration_s is not None:
        yield words, smooth
        yield from perturbed
    for factor in _STRETCH_FACTORS:
        if problem.motion.max_duration_s is None or factor * smooth.duration_s <= problem.motion.max_duration_s:
            yield f"{words} of {factor:g} times its least duration", stretched(smooth, factor * smooth.duration_s)
        yield next(perturbed)
    yield from perturbed


def _first_case(problem: Problem, start_pose: np.ndarray) -> MechanismCase:
    """Return the case of first solves: at a distance from singular poses, with ties broken, on a coarse mesh."""
    solver = problem.solver
    mesh = problem.mesh.replace(intervals=max(12, round(0.6 * problem.mesh.intervals)))
    compiled = "always" if solver.compile == "auto" else solver.compile
    iterations = min(FIRST_ITERATIONS, solver.max_iterations or FIRST_ITERATIONS)
    solver = solver.replace(compile=compiled, max_iterations=iterations)
    case = at_a_distance(case_of(problem), start_pose)
    return replace(case, problem=replace(case.problem, mesh=mesh, solver=solver), ties=FIRST_TIE_WEIGHT)
