"""Initial guesses of a user's problem: given ones, other durations, perturbed ones, and repairs of bad solutions."""

from collections.abc import Iterator
from dataclasses import replace

import casadi as ca
import numpy as np

from linkplan.planner.certificate.flow import flow
from linkplan.planner.ode.case import OdeCase
from linkplan.planner.ode.formulation import completed, straight_guess, units_of
from linkplan.planner.ode.problem import CompletedGuess, OdeProblem, StateGuess
from linkplan.planner.ode.trajectory import OdeTrajectory
from linkplan.planner.refinement.perturbation import perturbation
from linkplan.planner.transcription.formulation import Start

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
        tightened_share = perturbation(number, tau, size)
        state = np.clip(state + tightened_share.offset, limit[:, 0], limit[:, 1])
        low, high = problem.duration
        duration = float(np.clip(guess.duration_s * tightened_share.stretch, low, high))
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


def stretched(motion: OdeTrajectory, duration_s: float) -> OdeTrajectory:
    """Return a motion's states and efforts over another duration [s]."""
    return replace(motion, breaks_s=motion.breaks_s * (duration_s / motion.duration_s), running=None)


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
