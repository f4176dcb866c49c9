"""The search for a user's motion: starts, first solutions from them, the best of them refined, and what its rungs share.

Starts are given ones, other durations, perturbed ones, and repairs of bad solutions.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import casadi as ca
import numpy as np

from linkplan.planner.certificate.flow import flow
from linkplan.planner.ode.case import FirstSolution, OdeCase
from linkplan.planner.ode.certificate import OdeCertificate
from linkplan.planner.ode.formulation import completed, start_of, straight_guess, units_of
from linkplan.planner.ode.plan import OdePlan, plan_of
from linkplan.planner.ode.problem import CompletedGuess, OdeProblem, StateGuess
from linkplan.planner.ode.switches import has_arcs, is_affine, switch_by_costates
from linkplan.planner.ode.trajectory import OdeTrajectory
from linkplan.planner.refinement.case import Iterate, attempt
from linkplan.planner.refinement.decision import refine
from linkplan.planner.refinement.history import recorded
from linkplan.planner.refinement.perturbation import perturbation
from linkplan.planner.refinement.state import Refined
from linkplan.planner.refinement.switch_search import LONGER, bounded_by_guess
from linkplan.planner.search.ladder import Budget
from linkplan.planner.solvers.solve import INVALID, SOLVER_TOLERANCE
from linkplan.planner.transcription.formulation import Start
from linkplan.planner.transcription.mesh import Mesh, broken, uniform

# Factors on the first duration if the problem does not bound the duration: a motion may be quick or slow.
_DURATION_FACTORS = (4.0, 16.0, 0.25)
# Bounds of the least time, as shares of the given duration.
_LEAST_TIME_BOUNDS = (0.05, 4.0)
# Rows of a solution that serves as a guess.
_GUESS_ROWS = 101
# Constant efforts from which a motion with a free end is integrated, as shares of the range from lower to upper limit.
_EFFORT_SHARES = (0.5, 0.1)


def perturbed(problem: OdeProblem, given: list[CompletedGuess], n: int) -> Iterator[CompletedGuess]:
    """Yield n starts: the guesses, then the guesses perturbed at random, but the same in every run."""
    limit = problem.state_limit
    for number in range(n):
        guess = given[number % len(given)]
        if number < len(given):
            yield guess
            continue
        size = np.maximum(np.abs(guess.state).max(axis=0), units_of(problem, guess).state[: problem.n_x])
        # The smallest number of rows of a guess that is perturbed.
        tau = np.linspace(0.0, 1.0, max(41, len(guess.state)))
        at = np.linspace(0.0, 1.0, len(guess.state))
        state = np.column_stack([np.interp(tau, at, column) for column in guess.state.T])
        offset, stretch = perturbation(number, tau, size)
        state = np.clip(state + offset, limit[:, 0], limit[:, 1])
        low, high = problem.duration
        duration = float(np.clip(guess.duration_s * stretch, low, high))
        yield completed(problem, StateGuess(state=state, effort=guess.effort, duration_s=duration))


def is_open(problem: OdeProblem) -> bool:
    """True if neither the bounds nor a guess determine the duration roughly."""
    low, high = problem.duration
    # A free duration whose bounds are further apart than this factor is open.
    return high > 20.0 * low and not problem.guesses


def of_other_durations(problem: OdeProblem, guess: CompletedGuess) -> list[CompletedGuess]:
    """Return a guess at other durations within the bounds."""
    low, high = problem.duration
    durations = np.clip([factor * guess.duration_s for factor in _DURATION_FACTORS], low, high)
    return [replace(guess, duration_s=float(T)) for T in dict.fromkeys(durations) if T > 0 and guess.duration_s != T]


def integrated(problem: OdeProblem) -> Iterator[CompletedGuess]:
    """Yield the motions that constant efforts lead to, where the start is known and the end is free: each is a motion.

    A straight line says nothing of such an end: where states grow by orders of magnitude it is far from any motion.
    """
    start, limit = problem.start, problem.effort_limit
    free = not np.any(np.isfinite(problem.goal)) and problem.ends is None and not problem.returns
    if problem.guesses or not free or np.any(start[:, 0] != start[:, 1]):
        return
    given = straight_guess(problem)
    times, rate = np.linspace(0.0, given.duration_s, _GUESS_ROWS), problem.at_instant("rate")
    finite = np.all(np.isfinite(limit), axis=1)
    for share in _EFFORT_SHARES:
        low, high = np.where(finite[:, None], limit, given.effort[0][:, None]).T
        effort = low + share * (high - low)

        def rate_under(t: float, x: np.ndarray, effort: np.ndarray = effort) -> np.ndarray:
            return np.array(rate(x, effort, problem.parameters, t)).ravel()

        state = flow(
            rate_under, given.duration_s, start[:, 0], times / given.duration_s, problem.solver.certificate_deadline
        )
        if state is not None:
            yield replace(given, state=state, effort=np.tile(effort, (_GUESS_ROWS, 1)))


def with_smallest_efforts(problem: OdeProblem, guess: CompletedGuess) -> CompletedGuess:
    """Return a guess with efforts as near to zero as their limits allow."""
    return replace(guess, effort=np.tile(np.clip(np.zeros(problem.n_u), *problem.effort_limit.T), (2, 1)))


def of_least_time(problem: OdeProblem) -> OdeProblem:
    """Return the problem with the least time as its objective, its duration free about the one that was asked."""

    def final_cost(x0: ca.SX, xT: ca.SX, T: ca.SX, p: ca.SX) -> ca.SX:
        del x0, xT, p
        return T

    bounds = tuple(share * problem.duration[1] for share in _LEAST_TIME_BOUNDS)
    return replace(problem, running_cost=None, final_cost=final_cost, duration_s=bounds, objective_tolerance=None)


def sampled_guess(motion: OdeTrajectory) -> CompletedGuess:
    """Return a motion as a guess."""
    time = motion.breaks_s[0] + motion.duration_s * np.linspace(0.0, 1.0, _GUESS_ROWS)
    return CompletedGuess(state=motion.state_at(time), effort=motion.effort_at(time), duration_s=motion.duration_s)


def piecewise_constant(case: OdeCase, motion: OdeTrajectory) -> Start:
    """Return a solution as a start with each effort held over an interval.

    An effort that acts through its sine and cosine alone may leap by whole turns from node to node: the rows are kept there,
    and between them the polynomial is wild. Held over an interval, and the states as they are, it is next to a motion.
    """
    start, breaks = case.start_from(motion), motion.breaks_s

    def nodes(at: np.ndarray):
        acceleration, rate, algebraic, _ = start.nodes(at)
        k = np.clip(np.searchsorted(breaks, at, side="right") - 1, 0, len(breaks) - 2)
        # The share of an interval at which an effort is read that is held over the interval: the first node of radau-3.
        return acceleration, rate, algebraic, motion.effort_at(breaks[k] + 0.155 * np.diff(breaks)[k])

    return Start(states=start.states, nodes=nodes)


@dataclass(frozen=True, eq=False, kw_only=True)
class OdeSearch:
    """A search for the motion of a problem with a deadline, as every rung sees it; `plans` are those of the rungs so far."""

    problem: OdeProblem
    plans: list[OdePlan] = field(default_factory=list)

    @cached_property
    def guesses(self) -> list[CompletedGuess]:
        """The given guesses, completed, then the straight line between the given values of start and goal."""
        return [*(completed(self.problem, guess) for guess in self.problem.guesses), straight_guess(self.problem)]

    def within(self, budget: Budget) -> OdeProblem:
        """Return the problem with the settings that a budget allows its solves."""
        return replace(self.problem, solver=budget.of(self.problem.solver))

    @property
    def ended(self) -> bool:
        """Whether no further rung is tried: there is a plan, time is up, or every start gave numbers that are not finite."""
        steps = recorded()
        invalid = bool(steps) and all(step.solver_status == INVALID for step in steps)
        return bool(self.plans) or self.problem.solver.deadline.passed or invalid


def first_mesh(problem: OdeProblem) -> Mesh:
    """Return the mesh on which starts are solved."""
    return uniform(problem.mesh.intervals) if problem.mesh.breaks is None else broken(problem.mesh.breaks)


def first_solutions(
    problem: OdeProblem, starts: Iterable[CompletedGuess], *, enough: int | None = None, number: int = 0
) -> list[FirstSolution]:
    """Return the solutions that starts lead to on the first mesh, the first `enough` of them; they count from `number`."""
    found: list[FirstSolution] = []
    for k, guess in enumerate(problem.solver.deadline.take(starts), number):
        word = f"start {k + 1}" if k or problem.solver.starts > 1 else "first solve"
        one = _of_any_duration(_solved(problem, guess, word, k), word)
        if one is not None:
            found.append(one)
            if len(found) == enough:
                break
    return found


def _solved(problem: OdeProblem, guess: CompletedGuess, word: str, number: int) -> FirstSolution | None:
    """Return the solution on the first mesh from a completed guess, in its units."""
    case = OdeCase(problem, problem, units_of(problem, guess))
    found = attempt(case, start_of(guess, case.units), first_mesh(problem), np.array([guess.duration_s]), word)
    return None if found is None else FirstSolution(case=case, found=found, number=number)


def _of_any_duration(first: FirstSolution | None, word: str) -> FirstSolution | None:
    """Return a first solution whose duration is not bounded by its guess, or the words on one that has no best."""
    # A free duration that ended at the bound of its guess is solved for again; each time it may change a hundredfold.
    for restart in range(3):
        unbounded = None if first is None else unbounded_duration(first.case.asked, first.found)
        if unbounded is None:
            break
        # Guessed too short or too long by far: from what was found, with time in its own units.
        what, before = f"{word}, restarted from the bound on its duration", first
        first = _solved(first.case.asked, sampled_guess(first.found.motion), what, first.number)
        # Still a fraction of what it was, after time grew or shrank by what is beyond all guessing: there is no end.
        if first is not None and restart:
            falls = first.found.solution.objective < 0.5 * before.found.solution.objective
            first = replace(first, unbounded=unbounded if falls else None)
    return first


def unbounded_duration(
    problem: OdeProblem, found: Iterate[OdeTrajectory] | Refined[OdeTrajectory, OdeCertificate]
) -> str | None:
    """Return the words on a duration that ended at a bound which is not the user's but that of its guess; None elsewhere."""
    held, duration = bounded_by_guess(found.solution, *problem.duration), found.motion.duration_s
    if held is None:
        return None
    what, side = ("the objective is unbounded in the duration, the longer", "above") if held == LONGER else (
        "the duration has no least value, the shorter", "below"
    )  # fmt: skip
    return f"{what} the motion the better, still at {duration:.4g} s: bound duration_s from {side}"


def best_plan(problem: OdeProblem, found: Iterable[FirstSolution]) -> OdePlan | None:
    """Return the plan of the best first solution that is optimal once refined, or else the best plan; None without any."""
    failed, tried = None, np.zeros(0)
    best_first = sorted(found, key=lambda one: (one.found.solution.objective, one.number))
    for one in problem.solver.certificate_deadline.take(best_first):
        objective = one.found.solution.objective
        if np.any(np.abs(tried - objective) <= 1e-4 * abs(objective)):
            continue  # the same motion, that did not pass
        tried = np.append(tried, objective)
        refined = refined_motion(problem, one)
        plan = plan_of(problem, refined, one.unbounded or unbounded_duration(problem, refined))
        if plan.status == "optimal" or one.unbounded is not None:
            return plan
        failed = plan if failed is None or (failed.status, plan.status) == ("failed", "feasible") else failed
    return failed


def refined_motion(problem: OdeProblem, first: FirstSolution) -> Refined[OdeTrajectory, OdeCertificate]:
    """Return the motion that a first solution is refined to; one with switch times is taken as it is."""
    if not first.case.has_switch_times:
        asked = replace(problem, mesh=first.case.problem.mesh)
        first = replace(first, case=OdeCase(asked, problem, first.case.units))
        first = switch_by_costates(_with_linear_efforts(_without_wild_efforts(first)))
    guess = sampled_guess(first.found.motion)
    unstable = first.case.certify(first.found.motion).integration_restarts > 0
    if unstable:
        # In its own units, and from next to the coarser mesh: the solver loses such a motion more easily than others.
        first = replace(first, case=replace(first.case, units=units_of(problem, guess)))
    refined = refine(first.case, first.found, warm=unstable)
    assert refined is not None  # a user's solution always has a certificate
    if first.case.has_switch_times and not np.isfinite(refined.objective_error):
        # Solved on one mesh: next to an arc that vanishes the duration changes by the root of the solver's tolerance.
        refined = replace(refined, objective_error=float(np.sqrt(SOLVER_TOLERANCE)))
    return refined


def _without_wild_efforts(first: FirstSolution) -> FirstSolution:
    """Return a first solution whose efforts are no wild polynomials between its nodes."""
    case, motion = first.case, first.found.motion
    before = case.certify(motion).integration_error
    # Efforts are wild between the nodes if the integrated state ends this share of its size away.
    if before <= 1e-3:
        return first
    start, what = piecewise_constant(case, motion), "efforts piecewise constant at first"
    return _solved_again(first, case, start, before, what)


def _with_linear_efforts(first: FirstSolution) -> FirstSolution:
    """Return a first solution with efforts that are linear over intervals, where it has arcs on which they could chatter.

    On a singular arc only higher derivatives of the costates determine an effort that enters affinely. A polynomial through
    the nodes of an interval can oscillate there, a straight line cannot.
    """
    case, asked, motion = first.case, first.case.asked, first.found.motion
    if case.problem.mesh.effort != "polynomial" or not is_affine(asked) or not has_arcs(motion, asked.effort_limit):
        return first
    linear = replace(case, problem=replace(asked, mesh=replace(asked.mesh, effort="linear")))
    # Efforts linear over intervals replace polynomials if they reduce the integration error to this share.
    allowed = 0.01 * case.certify(motion).integration_error
    return _solved_again(first, linear, linear.start_from(motion), allowed, "efforts linear over intervals")


def _solved_again(first: FirstSolution, case: OdeCase, start: Start, allowed: float, what: str) -> FirstSolution:
    """Return a first solution solved again on its mesh, where that reduces the integration error below what is allowed."""
    durations = np.diff(first.found.motion.breaks_s[[0, -1]])
    again = attempt(case, start, first.found.mesh, durations, what, warm=True)
    if again is None or case.certify(again.motion).integration_error >= allowed:
        return first
    return replace(first, found=again, case=case)
