"""Solving a user's optimal-control problem: the search, refinement and certificate that mechanisms get.

problem = OdeProblem(name="double integrator", rate=lambda x, u, p, t: [x[1], u[0]], start=[0, 0], goal=[1, 0],
                     effort_limit=[[-1, 1]], duration_s=(0.1, 10), final_cost=lambda x0, xT, T, p: T)
plan = plan_ode(problem).require()        # plan.objective is 2, with one switch at T / 2
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from linkplan.models.deadline import one_thread_at_a_time
from linkplan.planner.ode.case import FirstSolution, OdeCase
from linkplan.planner.ode.certificate import functions_not_finite
from linkplan.planner.ode.formulation import start_of, units_of
from linkplan.planner.ode.plan import OdePlan, plan_without_motion
from linkplan.planner.ode.problem import CompletedGuess, OdeProblem
from linkplan.planner.ode.search import (
    OdeSearch,
    best_plan,
    first_mesh,
    first_solutions,
    integrated,
    is_open,
    of_least_time,
    of_other_durations,
    perturbed,
    sampled_guess,
    with_smallest_efforts,
)
from linkplan.planner.ode.switches import is_affine
from linkplan.planner.ode.trajectory import OdeTrajectory
from linkplan.planner.refinement.case import attempt
from linkplan.planner.refinement.history import Say, progress, record, recorded, recording, silent, step_of
from linkplan.planner.search.ladder import HURRIED, PATIENT, Budget, Rung, Steps, followed, try_in_turn
from linkplan.planner.solvers.solve import INVALID, OUT_OF_TIME, solve, why_stopped
from linkplan.planner.transcription.mesh import broken

__all__ = ["RUNGS", "OdePlan", "plan_ode"]


def from_several_starts(search: OdeSearch, budget: Budget) -> OdePlan | None:
    """Return the best plan of as many starts as the problem asks for (multistart)."""
    problem = search.within(budget)
    return best_plan(problem, first_solutions(problem, perturbed(problem, search.guesses, problem.solver.starts)))


def from_guesses(search: OdeSearch, budget: Budget) -> OdePlan | None:
    """Return the plan that the first guess with a solution leads to; the best of several starts if the duration is open."""
    problem = search.within(budget)
    found = first_solutions(problem, search.guesses, enough=1)
    if is_open(problem) and not search.ended:
        found += first_solutions(search.within(HURRIED), _further_guesses(search), number=len(search.guesses))
    return best_plan(problem, found)


def from_constant_efforts(search: OdeSearch, budget: Budget) -> OdePlan | None:
    """Return the plan that motions under constant efforts lead to, which exist where the end is free."""
    problem = search.within(budget)
    if is_affine(problem):  # efforts that are free to swing along singular arcs lead far away from there
        problem = replace(problem, mesh=replace(problem.mesh, effort="linear"))
    found = first_solutions(problem, integrated(problem), enough=1, number=len(search.guesses))
    return best_plan(search.within(budget), found)


def from_further_guesses(search: OdeSearch, budget: Budget) -> OdePlan | None:
    """Return the plan that the straight line with small efforts leads to, or other durations, or a perturbed guess."""
    problem = search.within(budget)
    starts = [with_smallest_efforts(problem, search.guesses[-1]), *_further_guesses(search)]
    found = first_solutions(problem, starts, enough=1, number=len(search.guesses))
    return best_plan(problem, found)


def _further_guesses(search: OdeSearch) -> list[CompletedGuess]:
    """Return the first guess at other durations, then guesses perturbed at random, but the same in every run."""
    n, guesses = len(search.guesses), search.guesses
    others = itertools.islice(perturbed(search.problem, guesses, n + 4), n, None)
    return [*of_other_durations(search.problem, guesses[0]), *others]


def from_least_limits(search: OdeSearch, budget: Budget) -> OdePlan | None:
    """Return the plan that the motion of the least effort limits leads to, or the reason why there is none.

    The limits are multiplied by the least factor that admits a motion. From a factor below 1 they grow to those asked for.
    If it is above 1 no motion is known within the limits, but a shorter one may be.
    """
    progress("no solution found; looking for the least effort that admits one")
    problem, guess = search.within(budget), search.guesses[0]
    case, durations = OdeCase(problem, problem, units_of(problem, guess)), np.array([guess.duration_s])
    transcribed = case.transcribe(start_of(guess, case.units), first_mesh(problem), durations, least_limit=True)
    solution = solve(transcribed, problem.solver)
    record(step_of("least effort limit", transcribed, solution))
    if not solution.converged:
        return None
    factor = float(solution.x[transcribed.program.layout.extra()][0])
    if factor > 1:
        return _beyond_the_limits(search, budget, factor)

    def limited(share: float) -> OdeProblem:
        return problem if share == 1.0 else replace(problem, effort_limit=share * problem.effort_limit)

    return _continued(case.motion(solution), limited, factor, 1.0, "start from the least limits")


def _beyond_the_limits(search: OdeSearch, budget: Budget, factor: float) -> OdePlan:
    """Return the plan begun from a shorter motion, or the answer on efforts that only a factor above 1 admits."""
    problem, asked_s = search.within(budget), search.problem.duration[1]
    found = f"efforts of {factor:.4g} times their limits are the least with which a motion was found"
    if problem.duration[0] < asked_s:
        # A motion may build up energy by swings that no start has tried: the factor proves nothing.
        return plan_without_motion(problem, "failed", f"no solution was found; {found}, which is no proof")
    progress("looking for the shortest feasible duration")
    shortest = from_guesses(OdeSearch(problem=of_least_time(search.problem)), budget)
    least_s = np.inf if shortest is None or shortest.status == "failed" else shortest.trajectory.duration_s
    if least_s > asked_s:
        return plan_without_motion(problem, "infeasible", found)

    def lasting(duration: float) -> OdeProblem:
        return replace(problem, duration_s=duration)

    # A motion that is not found is not called infeasible.
    known = f"no start led to a solution of {asked_s:.8g} s; a motion of {least_s:.8g} s is known, the shortest found"
    assert shortest.trajectory is not None  # it passes
    longer = _continued(shortest.trajectory, lasting, least_s, asked_s, "start from the least time")
    return longer or plan_without_motion(problem, "failed", known)


def _continued(
    motion: OdeTrajectory, problem_at: Callable[[float], OdeProblem], begin: float, end: float, what: str
) -> OdePlan | None:
    """Return the plan at the end of a continuation from a motion, on its mesh; None if the path is lost.

    Args:
        motion: the motion at the beginning.
        problem_at: the problem for a value of the parameter.
        begin: the parameter's first value.
        end: its last value, where the problem is the one that was asked.
        what: the words on the solves.
    """

    def solve_at(before: FirstSolution | None, value: float) -> FirstSolution | None:
        problem, start = problem_at(value), motion if before is None else before.found.motion
        stretch = float(np.clip(start.duration_s, *problem.duration)) / start.duration_s
        start = replace(start, breaks_s=start.breaks_s * stretch, running=None)
        case, breaks = OdeCase(problem, problem, units_of(problem, sampled_guess(start))), start.breaks_s - start.breaks_s[0]
        mesh, durations = broken(breaks / breaks[-1]), breaks[-1:]
        found = attempt(case, case.start_from(start), mesh, durations, what)
        return None if found is None else FirstSolution(case=case, found=found)

    # It begins with the whole way, from at most this share of the end. The smallest step is a quarter in the logarithm.
    way = end / min(begin, 0.999 * end)
    steps = Steps(begin=end / way, end=end, factor=way, halvings=2)
    path = followed(None, steps, solve_at)
    last = path.stages[-1]
    return best_plan(problem_at(end), [last]) if path.arrived and last is not None else None


# The first rung that finds a motion ends the search, whether its certificate passes or not.
RUNGS: tuple[Rung[OdeSearch], ...] = (
    Rung(
        name="several starts, the best of them (multistart)",
        tried=lambda search: search.problem.solver.starts > 1,
        climb=from_several_starts,
        budget=PATIENT,
    ),
    Rung(
        name="the guesses given, then the straight line",
        tried=lambda search: search.problem.solver.starts == 1,
        climb=from_guesses,
        budget=PATIENT,
    ),
    Rung(name="motions under constant efforts", climb=from_constant_efforts, budget=PATIENT),
    Rung(
        name="continuation in the effort limits, or in the duration",
        tried=lambda search: bool(np.all(np.isfinite(search.problem.effort_limit))),
        climb=from_least_limits,
        budget=PATIENT,
    ),
    Rung(name="small efforts, other durations, and perturbed guesses", climb=from_further_guesses, budget=HURRIED),
)


@one_thread_at_a_time
def plan_ode(problem: OdeProblem, say: Say = silent, ladder: Sequence[Rung[OdeSearch]] = RUNGS) -> OdePlan:
    """Return the solution of a problem; one without an answer says why in `message`.

    Args:
        problem: the problem; `solver.max_time_s` limits the whole plan. With `solver.starts` above 1 that many starts are
            solved: the guesses, the straight line and perturbations of them, the same in every run. The best is refined.
        say: called with a line of progress from time to time.
        ladder: the attempts, in order.
    """
    contradiction = _contradiction(problem)
    if contradiction is not None:
        return OdePlan(problem=problem, status="infeasible", message=contradiction)
    with recording(say):
        search = OdeSearch(problem=replace(problem, solver=problem.solver.begun()))
        try_in_turn(search, ladder)
        plan = search.plans[0] if search.plans else _nothing_found(search.problem)
    return replace(plan, problem=problem)


def _contradiction(problem: OdeProblem) -> str | None:
    """Return the sentence on a limit that no motion can keep, found without solving, or None."""
    for what, rows in (("start", problem.start), ("goal", problem.goal)):
        for name, (low, high), (least, most) in zip(problem.states, rows, problem.state_limit, strict=True):
            if low > most or high < least:
                asked = low if low > most else high
                return f"infeasible: {what} asks for {name} = {asked:g}, beyond its limits {least:g} to {most:g}"
    return None


def _not_finite_on_the_first_guess(problem: OdeProblem) -> list[str]:
    """Return the sentences on the problem's functions that are not finite along its first guess."""
    guess = OdeSearch(problem=problem).guesses[0]
    shares, known = np.linspace(0.0, 1.0, len(guess.state)), np.linspace(0.0, 1.0, len(guess.effort))
    effort = np.zeros((len(shares), problem.n_u))
    for k in range(problem.n_u):
        effort[:, k] = np.interp(shares, known, guess.effort[:, k])
    return functions_not_finite(problem, guess.duration_s * shares, guess.state, effort, guess.duration_s)


def _nothing_found(problem: OdeProblem) -> OdePlan:
    """Return the plan of a problem that no start solved; the first start had more time than later ones."""
    steps = recorded()
    status = steps[0].solver_status if steps else OUT_OF_TIME
    stopped = why_stopped(status, problem.solver.max_time_s)
    if status == INVALID:
        unknown = _not_finite_on_the_first_guess(problem)
        met = "the solver met a number that is not finite (NaN)"
        stopped = f"{met}: {'; '.join(unknown)} along the first guess" if unknown else stopped
    if stopped is not None:
        return OdePlan(problem=problem, status="failed", message=f"failed: {stopped}", history=steps)
    return plan_without_motion(problem, "failed", f"no start led to a solution ({status})")
