"""Solving a user's optimal-control problem: the transcription, refinement and certificate that mechanisms get.

problem = OdeProblem(name="double integrator", rate=lambda x, u, p, t: [x[1], u[0]], start=[0, 0], goal=[1, 0],
                     effort_limit=[[-1, 1]], duration_s=(0.1, 10), final_cost=lambda x0, xT, T, p: T)
plan = plan_ode(problem).require()        # plan.objective is 2, with one switch at T / 2

There is no search beyond the guesses, the straight line between the given values of start and goal, and perturbations of
them: what none of these leads to is "failed".
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.deadline import one_thread_at_a_time
from linkplan.planner.ode.case import OdeCase
from linkplan.planner.ode.certificate import OdeCertificate, functions_not_finite
from linkplan.planner.ode.formulation import completed, start_of, straight_guess, units_of
from linkplan.planner.ode.plan import OdePlan, plan_of, plan_without_motion
from linkplan.planner.ode.problem import CompletedGuess, OdeProblem, StateGuess
from linkplan.planner.ode.trajectory import OdeTrajectory
from linkplan.planner.refinement.case import Iterate, attempt
from linkplan.planner.refinement.decision import refine
from linkplan.planner.refinement.history import Say, recorded, recording, silent
from linkplan.planner.refinement.perturbation import perturbation
from linkplan.planner.refinement.state import Refined
from linkplan.planner.refinement.switch_search import LONGER, bounded_by_guess
from linkplan.planner.solvers.solve import INVALID, OUT_OF_TIME, why_stopped
from linkplan.planner.transcription.formulation import Start
from linkplan.planner.transcription.mesh import broken, uniform

__all__ = ["OdePlan", "plan_ode"]

# Rows of a solution that serves as a guess, and the fewest of a guess that is perturbed.
_GUESS_ROWS, _PERTURBED_ROWS = 101, 41
# Efforts are wild between the nodes if the integrated state ends this share of its size away. They are read then at this
# share of an interval: the first node of radau-3.
_WILD_SHARE, _FIRST_NODE = 1e-3, 0.155
# A free duration that ends at the bound of its guess is solved for again at most so often.
_MOST_RESTARTS = 3
# If the objective falls below this share of itself from one restart to the next, the duration is called unbounded.
_VANISHING_SHARE = 0.01


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _First:
    """A first solution and the case that it solves; `unbounded` has the words on a duration that has no best."""

    case: OdeCase
    found: Iterate[OdeTrajectory]
    unbounded: str | None = None


@one_thread_at_a_time
def plan_ode(problem: OdeProblem, say: Say = silent) -> OdePlan:
    """Return the solution of a problem; one without an answer says why in `message`.

    Args:
        problem: the problem; `solver.max_time_s` limits the whole plan. The first start with a solution is refined: the
            guesses, then the straight line. With `solver.starts` above 1 that many starts are solved, perturbed ones among
            them, the same in every run, and the best is refined.
        say: called with a line of progress from time to time.
    """
    contradiction = _contradiction(problem)
    if contradiction is not None:
        return OdePlan(problem=problem, status="infeasible", message=contradiction)
    with recording(say):
        begun = replace(problem, solver=problem.solver.begun())
        plan = _best_plan(begun, _first_solutions(begun)) or _nothing_found(begun)
    return replace(plan, problem=problem)


def guesses_of(problem: OdeProblem) -> list[CompletedGuess]:
    """Return the given guesses, completed, then the straight line between the given values of start and goal."""
    return [*(completed(problem, guess) for guess in problem.guesses), straight_guess(problem)]


def perturbed(problem: OdeProblem, given: list[CompletedGuess], n: int) -> Iterator[CompletedGuess]:
    """Yield n starts: the guesses, then the guesses perturbed at random, but the same in every run."""
    limit = problem.state_limit
    for number in range(n):
        guess = given[number % len(given)]
        if number < len(given):
            yield guess
            continue
        size = np.maximum(np.abs(guess.state).max(axis=0), units_of(problem, guess).state[: problem.n_x])
        tau = np.linspace(0.0, 1.0, max(_PERTURBED_ROWS, len(guess.state)))
        at = np.linspace(0.0, 1.0, len(guess.state))
        state = np.column_stack([np.interp(tau, at, column) for column in guess.state.T])
        offset, stretch = perturbation(number, tau, size)
        state = np.clip(state + offset, limit[:, 0], limit[:, 1])
        low, high = problem.duration
        duration = float(np.clip(guess.duration_s * stretch, low, high))
        yield completed(problem, StateGuess(state=state, effort=guess.effort, duration_s=duration))


def _first_solutions(problem: OdeProblem) -> list[_First]:
    """Return the solutions on the first mesh: of as many starts as are asked for, or of the first guess that has one."""
    several = problem.solver.starts > 1
    given = guesses_of(problem)
    starts = perturbed(problem, given, problem.solver.starts) if several else iter(given)
    found: list[_First] = []
    for k, guess in enumerate(problem.solver.deadline.take(starts)):
        one = _of_any_duration(problem, guess, f"start {k + 1}" if k or several else "first solve")
        if one is not None:
            found.append(one)
            if not several:
                break
    return found


def _of_any_duration(problem: OdeProblem, guess: CompletedGuess, word: str) -> _First | None:
    """Return the solution from a guess, solved again while its duration is bounded by its guess."""
    first = _solved(problem, guess, word)
    for restart in range(_MOST_RESTARTS):
        unbounded = None if first is None else unbounded_duration(problem, first.found)
        if first is None or unbounded is None:
            break
        # Guessed too short or too long by far: from what was found, with time in its own units.
        before, first = first, _solved(problem, sampled_guess(first.found.motion), f"{word}, from the bound on its duration")
        # Next to nothing of what it was, after time grew or shrank by what is beyond all guessing: there is no end.
        if first is not None and restart:
            vanishes = first.found.solution.objective < _VANISHING_SHARE * before.found.solution.objective
            first = replace(first, unbounded=unbounded if vanishes else None)
    return first


def _solved(problem: OdeProblem, guess: CompletedGuess, word: str) -> _First | None:
    """Return the solution on the first mesh from a completed guess, in its units."""
    case = OdeCase(problem, problem, units_of(problem, guess))
    mesh = uniform(problem.mesh.intervals) if problem.mesh.breaks is None else broken(problem.mesh.breaks)
    found = attempt(case, start_of(guess, case.units), mesh, np.array([guess.duration_s]), word)
    return None if found is None else _First(case=case, found=found)


def sampled_guess(motion: OdeTrajectory) -> CompletedGuess:
    """Return a motion as a guess."""
    time = motion.breaks_s[0] + motion.duration_s * np.linspace(0.0, 1.0, _GUESS_ROWS)
    return CompletedGuess(state=motion.state_at(time), effort=motion.effort_at(time), duration_s=motion.duration_s)


def unbounded_duration(
    problem: OdeProblem, found: Iterate[OdeTrajectory] | Refined[OdeTrajectory, OdeCertificate]
) -> str | None:
    """Return the words on a duration that ended at a bound which is not the user's but that of its guess; None elsewhere."""
    bound, duration = bounded_by_guess(found.solution, *problem.duration), found.motion.duration_s
    if bound is None:
        return None
    what, side = ("the objective is unbounded in the duration, the longer", "above") if bound == LONGER else (
        "the duration has no least value, the shorter", "below"
    )  # fmt: skip
    return f"{what} the motion the better, still at {duration:.4g} s: bound duration_s from {side}"


def _best_plan(problem: OdeProblem, found: list[_First]) -> OdePlan | None:
    """Return the plan of the best first solution that is optimal once refined, or else the best plan; None without any."""
    failed, tried = None, np.zeros(0)
    best_first = sorted(found, key=lambda one: one.found.solution.objective)
    for one in problem.solver.certificate_deadline.take(best_first):
        objective = one.found.solution.objective
        if np.any(np.abs(tried - objective) <= 1e-4 * abs(objective)):
            continue  # the same motion, that did not pass
        tried = np.append(tried, objective)
        refined = _refined(problem, one)
        plan = plan_of(problem, refined, one.unbounded or unbounded_duration(problem, refined))
        if plan.status == "optimal" or one.unbounded is not None:
            return plan
        failed = plan if failed is None or (failed.status, plan.status) == ("failed", "feasible") else failed
    return failed


def _refined(problem: OdeProblem, first: _First) -> Refined[OdeTrajectory, OdeCertificate]:
    """Return the motion that a first solution is refined to."""
    first = _without_wild_efforts(first)
    case, motion = first.case, first.found.motion
    unstable = case.certify(motion).integration_restarts > 0
    if unstable:
        # In its own units, and from next to the coarser mesh: the solver loses such a motion more easily than others.
        case = replace(case, units=units_of(problem, sampled_guess(motion)))
    refined = refine(case, first.found, warm=unstable)
    assert refined is not None  # a user's solution always has a certificate
    return refined


def _without_wild_efforts(first: _First) -> _First:
    """Return a first solution whose efforts are no wild polynomials between its nodes.

    An effort that acts through its sine and cosine alone may leap by whole turns from node to node: the rows are kept there,
    and between them the polynomial is wild. Held over an interval, and the states as they are, it is next to a motion.
    """
    case, motion = first.case, first.found.motion
    before = case.certify(motion).integration_error
    if before <= _WILD_SHARE:
        return first
    start, breaks = case.start_from(motion), motion.breaks_s

    def nodes(at: np.ndarray):
        acceleration, rate, algebraic, _ = start.nodes(at)
        k = np.clip(np.searchsorted(breaks, at, side="right") - 1, 0, len(breaks) - 2)
        return acceleration, rate, algebraic, motion.effort_at(breaks[k] + _FIRST_NODE * np.diff(breaks)[k])

    held, durations = Start(states=start.states, nodes=nodes), np.diff(breaks[[0, -1]])
    again = attempt(case, held, first.found.mesh, durations, "efforts piecewise constant at first", warm=True)
    return first if again is None or case.certify(again.motion).integration_error >= before else replace(first, found=again)


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
    guess = guesses_of(problem)[0]
    shares, known = np.linspace(0.0, 1.0, len(guess.state)), np.linspace(0.0, 1.0, len(guess.effort))
    effort = np.zeros((len(shares), problem.n_u))
    for k in range(problem.n_u):
        effort[:, k] = np.interp(shares, known, guess.effort[:, k])
    return functions_not_finite(problem, guess.duration_s * shares, guess.state, effort, guess.duration_s)


def _nothing_found(problem: OdeProblem) -> OdePlan:
    """Return the plan of a problem that no start solved."""
    steps = recorded()
    status = steps[0].solver_status if steps else OUT_OF_TIME
    stopped = why_stopped(status, problem.solver.max_time_s)
    if status == INVALID:
        unknown = _not_finite_on_the_first_guess(problem)
        met = "the solver met a number that is not finite (NaN)"
        stopped = f"{met}: {'; '.join(unknown)} along the first guess" if unknown else stopped
    if stopped is not None:
        return OdePlan(problem=problem, status="failed", message=f"failed: {stopped}", history=steps)
    return plan_without_motion(problem, "failed", f"no start led to a solution ({status}): give `guesses`, or more starts")
