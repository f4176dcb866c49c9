"""Multistart: cheap first solves from several starts; the best are refined, and every certified motion is a bound.

There are several local optima, and no start certainly leads to the best. A problem may set the number of starts.
With several motors, starts are tried until the best objective was found twice (Boender & Rinnooy Kan, Mathematical
Programming 37, 1987, have such stopping rules). Their first solves take tens of iterations under three conditions: iterates
keep a distance from singular poses; a small weight on efforts breaks the ties of joints with slack time; and, if the
duration is free, the barrier parameter of every other solve follows the iterates.
"""

import contextlib
import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.deadline import Deadline, OutOfTimeError
from linkplan.planner.certificate.further_checks import objective_value
from linkplan.planner.closed_chain.case import MechanismCase, case_of
from linkplan.planner.closed_chain.formulate import FIRST_TIE_WEIGHT, TIE_WEIGHT, tie_weights
from linkplan.planner.closed_chain.guess import Guess, closes, guess_from, perturbed_guesses, stretched, swinging_guesses
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.case import Iterate, attempt, share_gained
from linkplan.planner.refinement.history import progress
from linkplan.planner.search.attempts import certified, objective_of, of_several, without_solving
from linkplan.planner.search.finer_meshes import FIRST_MARGIN, LAST_MARGIN, at_a_distance
from linkplan.planner.search.methods import Budget, Search
from linkplan.planner.search.solving import first_mesh, with_longer_durations
from linkplan.planner.search.starts import is_too_short, no_time, of_the_phase_plane
from linkplan.planner.search.without_solver import slower
from linkplan.planner.solvers.solve import OF_TIME

# Most iterations of a first solve.
FIRST_ITERATIONS = 200
# Least and largest number of first solves that lead to a motion, and the largest number of starts.
_FEWEST_FOUND, _MOST_FOUND, _MOST_STARTS = 2, 6, 10
# After the first motion, first solves take at most this share of the time. The rest is for refining the best one.
_SHARE_OF_FIRST = 1.0 / 3.0
# Objectives of first solves that differ by at most this share belong to the same motion.
_ALIKE_SHARE = 1e-3
# Number of the best motions that are refined.
_MOST_REFINED = 3
# Factors on the duration of a motion that does not pass, for the search for a motion of little effort.
_SLOWER_FACTORS = (1.05, 1.3)
_TIES = f"joints with slack time move smoothly by a weight of {TIE_WEIGHT:g} on squared efforts, which breaks ties"
# Factors on the duration of the smooth path, as initial guesses of a free duration.
_STRETCH_FACTORS = (0.7, 1.5, 1.0)


@dataclass(frozen=True, eq=False, slots=True)
class _First:
    """A first solution, its start's number and name, and its objective without the weight that breaks ties."""

    number: int
    what: str
    found: Iterate
    objective: float


def from_several_starts(search: Search, budget: Budget) -> Plan | None:
    """Return the best passing plan of several starts, else the first plan found; None without a motion."""
    problem, wanted = search.within(budget), search.problem.solver.starts
    tried, in_time, solved = _first_solutions(search, budget)
    firsts = _different(solved)
    plans: list[Plan] = []
    for first in problem.solver.certificate_deadline.take(firsts if wanted > 1 else firsts[:_MOST_REFINED]):
        progress(f"refining the motion from {first.what}")
        found, unbounded = with_longer_durations(problem, first.found)
        if unbounded is not None:
            search.verdicts.append(Plan(problem=search.problem, verdict=unbounded))
            return None
        plan = certified(problem, found)
        if wanted > 1:
            told = {"starts": wanted, "starts_solved": len(solved), "best_start": first.number}
            plan = replace(plan, details={**plan.details, **told})
        plans.append(plan)
        if plan.passed:
            break
    best = plans[-1] if plans and plans[-1].passed else None
    if problem.motion.duration_s is None and best is None:
        known = [plan.trajectory for plan in plans if plan.trajectory is not None]
        a_little = slower(problem, [*known, *(first.found.motion for first in firsts[:1])])
        if a_little is not None:
            return a_little
    best = best or (_in_more_time(search.problem, firsts[0]) if firsts else None)
    if best is None:
        return min(plans, key=lambda plan: not plan.passed, default=None)
    better = firsts[0].objective
    if not (plans and best is plans[0]) and _cheaper(better, best):
        return best.adding(f"a motion with {better:.6g} was found, but does not pass its certificate", kind="feasible")
    if tried < wanted:
        share = f"in their share of the {problem.solver.max_time_s:g} s {OF_TIME}"
        why = "and the loops open along all others" if in_time else share
        best = best.adding(f"{tried} of the {wanted} starts were tried {why}", out_of_time=not in_time)
    if not of_several(problem):
        return best
    said = _TIES if np.any(tie_weights(problem, TIE_WEIGHT)) else ""
    return best.adding(said, _margin_kept(problem, best))


def _margin_kept(problem: Problem, plan: Plan) -> str:
    """Return the phrase on an active distance from singular poses that the problem does not require, or ""."""
    ratio = plan.certificate.singularity_ratio if plan.certificate is not None else np.inf
    met = [margin for margin in (FIRST_MARGIN, LAST_MARGIN) if 0.9 * margin <= ratio <= 1.02 * margin]
    if not met or met[0] <= problem.limits.singular_margin:
        return ""
    return f"it keeps a distance from singular poses, {met[0]:g} of that at home; a motion nearer to them may cost less"


def _in_more_time(problem: Problem, first: _First) -> Plan | None:
    """Return the plan of a motion of little effort in more time, which bounds the cost of a free duration, or None."""
    if problem.motion.duration_s is not None:
        return None
    motion = first.found.motion
    for factor in _SLOWER_FACTORS:
        duration = factor * motion.duration_s
        if duration > (problem.motion.max_duration_s or np.inf):
            break
        fixed = replace(problem.motion, duration_s=duration, min_duration_s=None, max_duration_s=None)
        asked = problem.varied(objective="effort", motion=fixed)
        case, guess = _first_case(asked, motion.start_pose), stretched(guess_from(motion), duration)
        mesh, durations = first.found.mesh, factor * first.found.durations
        found = attempt(case, guess, mesh, durations, f"{factor:g} times slower", adaptive=True)
        plan = None if found is None else certified(asked, found)
        if plan is not None and plan.passed:
            found = plan.require_motion("bound the duration with")
            late = problem.varied(solver=problem.solver.replace(deadline=problem.solver.judging_deadline))
            bound = without_solving(late, found, objective_value(problem, found)[0], f"motion of {duration:.6g} s")
            return bound if bound.passed else slower(problem, [found])
    return None


def _first_solutions(search: Search, budget: Budget) -> tuple[int, bool, list[_First]]:
    """Return the number of starts that were tried, whether they ended before their time did, and their solutions.

    If the problem sets more than one start, this many are tried. Otherwise the starts end once the best motion was found
    twice.
    """
    problem, wanted = search.within(budget), search.problem.solver.starts
    case, several, most = _first_case(problem, search.start_pose), of_several(problem), max(wanted, _MOST_STARTS)
    after_first = search.deadline.within_share(_SHARE_OF_FIRST)
    number, found = 0, list[_First]()
    starts = itertools.islice(_starts(search, budget, found), 20 * most)  # the loops open along some of them
    closed = (start for start in starts if closes(problem, start[1]))
    with contextlib.suppress(OutOfTimeError):
        for number, (what, guess) in enumerate(search.deadline.take(itertools.islice(closed, most)), start=1):
            word, timed = f"start {number} of {wanted}, {what}", case
            if wanted == 1:
                if found and after_first.passed:
                    break
                word, timed = f"start from {what}", _in_time(case, found, after_first)
            adaptive = several and number % 2 == 1 and problem.motion.duration_s is None
            one = attempt(timed, guess, *first_mesh(timed.problem, guess), word, adaptive=adaptive)
            if one is not None:
                found.append(_First(number, what, one, objective_of(one)))
            if number >= wanted > 1 or (wanted == 1 and _enough(found)):
                break
    return number, not (problem.solver.deadline.passed or search.deadline.passed), found


def _enough(found: list[_First]) -> bool:
    """True if the best of the first solutions was found twice, or if there are enough of them."""
    best = min((first.objective for first in found), default=np.inf)
    twice = sum(_alike(first.objective, best) for first in found) > 1
    return len(found) >= _MOST_FOUND or (len(found) >= _FEWEST_FOUND and twice)


def _different(found: list[_First]) -> list[_First]:
    """Return one solution for each different motion, in order of objective."""
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
    return replace(case, problem=case.problem.varied(solver=solver))


def _cheaper(objective: float, plan: Plan) -> bool:
    """True if an objective is so much less than a plan's that it belongs to another motion."""
    assert plan.objective is not None
    return share_gained(plan.objective, objective) > _ALIKE_SHARE


def _alike(one: float, other: float) -> bool:
    return abs(share_gained(one, other)) <= _ALIKE_SHARE


def _starts(search: Search, budget: Budget, found: list[_First]) -> Iterator[tuple[str, Guess]]:
    """Yield starts, each with its name for messages, the most promising first.

    If two starts led to no motion in the given time, the least time shows whether more starts are worth it.
    """
    problem, perturbed = search.problem, perturbed_guesses(search.problem, search.start_pose)
    if not of_several(problem):
        yield from search.first_starts()
        if not no_time(search):
            yield from of_the_phase_plane(search, budget) if search.quickest is not None else ()
            yield from (("a swing", swing) for swing in swinging_guesses(problem, search.start_pose))
        yield from perturbed
    *own, (words, smooth) = search.first_starts()
    yield from own
    if problem.motion.duration_s is not None:
        yield words, smooth
        yield from itertools.islice(perturbed, 1)
        if not found and problem.solver.starts == 1 and is_too_short(search):
            return
        yield from perturbed
    for factor in _STRETCH_FACTORS:
        if problem.motion.max_duration_s is None or factor * smooth.duration_s <= problem.motion.max_duration_s:
            yield f"{words} of {factor:g} times its least duration", stretched(smooth, factor * smooth.duration_s)
        yield next(perturbed)
    yield from perturbed


def _first_case(problem: Problem, start_pose: np.ndarray) -> MechanismCase:
    """Return the case of first solves.

    With several motors it has a coarse mesh, a distance from singular poses, and a weight on efforts that breaks ties.
    """
    if not of_several(problem):
        return case_of(problem)
    solver = problem.solver
    mesh = problem.mesh.replace(intervals=max(12, round(0.6 * problem.mesh.intervals)))
    compiled = "always" if solver.compile == "auto" else solver.compile
    iterations = min(FIRST_ITERATIONS, solver.max_iterations or FIRST_ITERATIONS)
    solver = solver.replace(compile=compiled, max_iterations=iterations)
    case = at_a_distance(case_of(problem), start_pose)
    return replace(case, problem=case.problem.varied(mesh=mesh, solver=solver), ties=FIRST_TIE_WEIGHT)
