"""Prescribed motions: a reference or a smooth path followed exactly, or a pose held, with the effort that it needs."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.actuation.distribution import distribute, missed_rounding
from linkplan.models.poses.along import demanded, is_redundant
from linkplan.models.poses.assembly import close_at
from linkplan.planner.closed_chain.guess import Guess, force_times, guess_from, poses_along, reference_guess, stretched
from linkplan.planner.limits.kinds import beyond_bounds, effort_bounds, margins_along, needed_efforts
from linkplan.planner.limits.limit import Margin
from linkplan.planner.limits.samples import Samples, samples_of
from linkplan.planner.plan.verdict import Overrun
from linkplan.planner.problem.keys.kinds import MIN_INTERVAL_SHARE
from linkplan.planner.problem.objective import motor_losses
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.reference import repeats_in
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.bernstein import bernstein_integral, bernstein_matrix

# Degree of the polynomials that represent a smooth reference on an interval. With forty intervals in a period, their
# interpolation error is at rounding.
_REFERENCE_DEGREE = 8
# Halvings of the interval between two samples in which a switch lies: down to rounding of its time.
_SWITCH_HALVINGS = 50
# Instants at which efforts bound the rate of a reference, and the share below this bound within which the highest rate is
# if efforts limit it: between these instants of a period their peak is larger by about (2 pi / 1001)^2 / 8.
_BOUNDING_INSTANTS, _NEAR_BOUND = 1001, 1e-5


def prescribe(problem: Problem, start_pose: np.ndarray) -> Trajectory:
    """Return the reference as a trajectory with efforts by inverse dynamics.

    A period has the problem's number of intervals and the motion at least eight; the reference is a polynomial or smooth on
    each.
    """
    guess, reference = reference_guess(problem, start_pose), problem.reference
    assert reference is not None  # as of `reference_guess`
    T, period_s = guess.duration_s, reference.period_s
    inner = np.sort(np.concatenate([reference.inner_times(T), force_times(problem)]))
    inner = inner[np.diff(inner, prepend=0.0) > MIN_INTERVAL_SHARE * T]
    knots = np.concatenate([[0.0], inner, [T]])
    least = max(problem.mesh.intervals / period_s, 8 / T) * np.diff(knots)
    counts = np.ceil(least - 1e-9).astype(int)
    parts = [np.linspace(knots[k], knots[k + 1], int(n), endpoint=False) for k, n in enumerate(counts)]
    motion = motion_along(problem, guess, np.append(np.concatenate(parts), T))
    forces = problem.mechanism.forces
    return replace(motion, periodic=repeats_in(reference, T) and (forces is None or forces.curve.periodic))


def motion_along(problem: Problem, guess: Guess, breaks_s: np.ndarray) -> Trajectory:
    """Return a guess as a trajectory with its efforts, else with those of inverse dynamics.

    Args:
        problem: of the motion.
        guess: whose accelerations are smooth between breaks, and whose efforts are polynomials there of degree 8 at most.
        breaks_s: the intervals' ends (n + 1,) [s], from 0 to the guess's duration.

    Raises:
        AssemblyError: if its loops cannot close.
        OutOfTimeError: if the problem's deadline passes meanwhile.
    """
    mechanism = problem.mechanism
    if guess.effort is None and is_redundant(mechanism):
        breaks_s = _with_shared_breaks(problem, guess, breaks_s)
    n, h = len(breaks_s) - 1, np.diff(breaks_s)[:, None]
    tau = 0.5 - 0.5 * np.cos(np.pi * (np.arange(_REFERENCE_DEGREE + 1) + 0.5) / (_REFERENCE_DEGREE + 1))
    to_bernstein = np.linalg.inv(bernstein_matrix(_REFERENCE_DEGREE, tau))
    time = (breaks_s[:-1, None] + h * tau).ravel()
    a = guess.acceleration(time)
    effort = _efforts_along(problem, guess, time) if guess.effort is None else guess.effort(time)

    def coefficients(values: np.ndarray) -> np.ndarray:
        return np.einsum("pj,kjs->pks", to_bernstein, values.reshape(n, _REFERENCE_DEGREE + 1, -1))

    s0, v0 = guess.position(breaks_s[:-1]), guess.velocity(breaks_s[:-1])
    first = np.einsum("pj,jks->pks", bernstein_integral(_REFERENCE_DEGREE), coefficients(a))
    velocity = v0 + h * first
    second = np.einsum("pj,jks->pks", bernstein_integral(_REFERENCE_DEGREE + 1), first)
    steps = (np.arange(_REFERENCE_DEGREE + 3) / (_REFERENCE_DEGREE + 2))[:, None, None]
    efforts, limit = coefficients(effort), effort_bounds(problem)
    inside = np.clip(efforts, *limit.T)  # shared efforts rest at limits for whole intervals: interpolation rounds there
    return Trajectory(
        breaks_s=breaks_s,
        position=s0 + steps * h * v0 + h**2 * second,
        velocity=velocity,
        effort=np.where(np.abs(efforts - inside) <= missed_rounding(limit), inside, efforts),
        start_pose=guess.start_pose,
        periodic=False,
    )


def _efforts_along(problem: Problem, guess: Guess, time: np.ndarray) -> np.ndarray:
    """Return the efforts (n, n_u) of inverse dynamics along a guess at increasing times (n,)."""
    poses = poses_along(problem.mechanism, guess, time, problem.solver.deadline)
    v, a = guess.velocity(time), guess.acceleration(time)
    return needed_efforts(problem, poses, v, a, time)[0]


def _with_shared_breaks(problem: Problem, guess: Guess, breaks_s: np.ndarray) -> np.ndarray:
    """Return breaks with those instants at which more actuators than freedoms reach or leave their limits.

    Efforts that share a generalised effort within limits have kinks there, which no polynomial follows.
    """
    least, most = effort_bounds(problem).T

    def at_limits(time: np.ndarray) -> np.ndarray:
        effort = _efforts_along(problem, guess, time)
        return (effort >= most) * 1 - (effort <= least)

    parts = np.arange(_REFERENCE_DEGREE) / _REFERENCE_DEGREE
    time = np.append((breaks_s[:-1, None] + np.diff(breaks_s)[:, None] * parts).ravel(), breaks_s[-1])
    which = at_limits(time)
    k = np.flatnonzero(np.any(which[1:] != which[:-1], axis=1))
    begin, end, before, after = time[k], time[k + 1], which[k], which[k + 1]
    every = breaks_s
    for _ in range(2 * which.shape[1]):  # several may reach or leave limits between two samples, one after another
        if not len(begin):
            break
        low, high = begin, end
        for _ in range(_SWITCH_HALVINGS):
            middle = 0.5 * (low + high)
            same = np.all(at_limits(middle) == before, axis=1)
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        every, before = np.union1d(every, high), at_limits(high)
        left = np.any(before != after, axis=1)
        begin, end, before, after = high[left], end[left], before[left], after[left]
    kept = np.diff(every, prepend=-np.inf) > MIN_INTERVAL_SHARE * guess.duration_s
    kept[-1] = True
    return every[kept | np.isin(every, breaks_s)]


def in_more_time(problem: Problem, motion: Trajectory, factor: float) -> Trajectory:
    """Return a motion that takes `factor` times as long, by inverse dynamics; errors as of `motion_along`."""
    guess = stretched(guess_from(motion), factor * motion.duration_s)
    found = motion_along(problem, guess, factor * motion.breaks_s)
    return replace(found, periodic=motion.periodic, along=motion.along)


def rounded_down(value: float) -> float:
    """Return a positive number rounded down to four digits, so that a printed bound is still valid."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 3)
    return float(np.floor(value / unit) * unit)


def rounded_up(value: float) -> float:
    """Return a positive number rounded up to four digits."""
    return 1.0 / rounded_down(1.0 / value)


def at_rate(problem: Problem, rate: float) -> Problem:
    """Return a problem whose reference is followed `rate` times as fast, over the same number of periods."""
    given = problem.motion.duration_s
    motion = replace(problem.motion, duration_s=None if given is None else given / rate)
    return problem.varied(reference=problem.reference.stretched(1.0 / rate), motion=motion)


def rate_margins(problem: Problem, start_pose: np.ndarray, rate: float) -> list[Margin]:
    """Return the margins of all limits along the reference, followed `rate` times as fast."""
    return list(margins_along(along_reference(at_rate(problem, rate), start_pose)))


def along_reference(problem: Problem, start_pose: np.ndarray) -> Samples:
    """Return samples of the reference."""
    return samples_of(problem, prescribe(problem, start_pose))


def reference_overrun(at: Samples) -> Margin | None:
    """Return the largest overrun of the reference followed exactly, as a share of the limit's size; None without any."""
    over = [margin for margin in margins_along(at) if not margin.kept]
    return min(over, key=lambda margin: margin.share, default=None)


def undriven_need(at: Samples, allowed: float) -> Overrun | None:
    """Return the largest generalised effort, if above the allowed one, that the reference needs and no actuator can give."""
    missed = needed_efforts(at.problem, at.q, at.v, at.a, at.time)[1]
    k, row = np.unravel_index(int(np.argmax(np.abs(missed))), missed.shape)
    if abs(missed[k, row]) <= allowed:
        return None
    joint, value = at.problem.mechanism.independent_joints[row], float(missed[k, row])
    unit = joint.si_units[1]
    return Overrun(limit="effort", name=joint.name, value=value, bound=0.0, unit=unit, time_s=float(at.time[k]))


def balanced_rates(problem: Problem, start_pose: np.ndarray) -> list[float] | None:
    """Return rates besides 1 at which joints without an actuator may follow the reference; None if they do at every rate.

    At a rate r the reference lacks a + b r + c r^2. Where this is zero, the sum of its squares is stationary.
    """
    guess, own = reference_guess(problem, start_pose), np.array([0.5, 1.0, 2.0])
    time = np.linspace(0.0, guess.duration_s, _BOUNDING_INSTANTS)
    poses = poses_along(problem.mechanism, guess, time, problem.solver.deadline)
    v, a = guess.velocity(time), guess.acceleration(time)
    missed = np.array([needed_efforts(problem, poses, r * v, r**2 * a)[1].ravel() for r in own])
    if np.abs(missed).max() <= missed_rounding(effort_bounds(problem)):
        return None
    along = [along_reference(at_rate(problem, rate), start_pose) for rate in own]
    if all(undriven_need(at, at.lacking_rounding) is None for at in along):
        return None
    parts = np.linalg.solve(np.vander(own, increasing=True), missed)
    products = parts @ parts.T
    squares = np.polynomial.Polynomial([np.trace(products[::-1], k) for k in range(-2, 3)])
    roots = squares.deriv().roots()
    return [float(r.real) for r in roots if r.real > 0 and abs(r.imag) < _NEAR_BOUND * abs(r)]


def highest_rate(problem: Problem, start_pose: np.ndarray, slowest: float, fastest: float) -> float | None:
    """Return the highest rate at which the reference satisfies every limit, by bisection; None if there is none.

    Rates are between `slowest` and `fastest`. Efforts at some instants, which are quickly known, bound them.
    """

    def holds(rate: float) -> bool:
        faster = at_rate(problem, rate)
        guess = reference_guess(faster, start_pose)
        effort = _efforts_along(faster, guess, np.linspace(0.0, guess.duration_s, _BOUNDING_INSTANTS))
        return bool(beyond_bounds(faster, effort).max() <= missed_rounding(effort_bounds(faster)))

    def keeps(rate: float) -> bool:
        return all(margin.kept for margin in rate_margins(problem, start_pose, rate))

    at_most = highest_kept_rate(holds, slowest, fastest)
    return None if at_most is None else highest_kept_rate(keeps, slowest, at_most)


def at_rate_along(problem: Problem, motion: Trajectory, rate: float) -> Trajectory:
    """Return a motion `rate` times as fast, with efforts by inverse dynamics.

    Raises:
        AssemblyError: if its loops cannot close.
    """
    faster = stretched(guess_from(motion), motion.duration_s / rate)
    found = motion_along(problem, faster, (motion.breaks_s - motion.breaks_s[0]) / rate)
    return replace(found, periodic=motion.periodic, along=motion.along)


def highest_kept_rate(keeps: Callable[[float], bool], slowest: float, fastest: float) -> float | None:
    """Return the highest rate from `slowest` to `fastest` that is feasible, by bisection; None if there is none.

    All rates below a feasible one are assumed to be feasible. If the holding effort at rest exceeds that in motion,
    `slowest` is not feasible; the bisection then begins at the motion's own speed.
    """
    if keeps(fastest):
        return fastest
    low = next(
        (rate for rate in ((1 - _NEAR_BOUND) * fastest, slowest, 1.0) if slowest <= rate < fastest and keeps(rate)), None
    )
    high = fastest
    while low is not None and high > (1 + 1e-7) * low:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if keeps(middle) else (low, middle)
    return low


# Terms of an objective that at rest are squares of efforts or constant. For these, the least of all holding efforts are
# best.
SQUARES_AT_REST = {"effort", "copper_loss", "effort_rate", "work", "time"}


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Holding:
    """The constant efforts that hold a pose at rest within their limits, or the missing ones.

    `needed` (n_u,) [N.m or N] are the best within the limits, else those that violate the limits least, and `effort` (n_u,)
    the same within the limits; `missed` (n_s,) is the part of the holding effort that `effort` does not provide. `best`: no
    other holding efforts cost less.
    """

    s: np.ndarray  # (n_s,) [rad or m]
    pose: np.ndarray  # (n_q,) closed
    effort: np.ndarray
    needed: np.ndarray
    missed: np.ndarray
    slack: float  # the largest `missed` that is due to rounding
    unique: bool  # whether no other efforts hold the pose
    best: bool

    @property
    def holds(self) -> bool:
        """Whether the efforts hold the pose."""
        return bool(np.abs(self.missed).max(initial=0.0) <= self.slack)

    def lasting(self, duration_s: float) -> Trajectory:
        """Return the rest of a duration [s]."""
        constants = zip((self.s, np.zeros_like(self.s), self.effort), (3, 2, 2), strict=True)
        position, velocity, effort = (np.broadcast_to(x, (k, 1, len(x))) for x, k in constants)
        return Trajectory(
            breaks_s=np.array([0.0, duration_s]),
            position=position,
            velocity=velocity,
            effort=effort,
            start_pose=self.pose,
            periodic=False,
        )


def holding_at(problem: Problem, s: np.ndarray) -> Holding:
    """Return the efforts that hold a pose s (n_s,) [rad or m] at rest.

    Raises:
        AssemblyError: if the loops do not close there.
    """
    mechanism, limit, objective = problem.mechanism, effort_bounds(problem), problem.objective
    pose, still = close_at(mechanism, s), np.zeros((1, mechanism.dof))
    tau, maps = demanded(mechanism, pose[None], still, still)
    # In units in which the squares of all efforts have the same cost.
    price = objective.weight("effort") + objective.weight("copper_loss") * motor_losses(problem.motors)
    unit = 1.0 / np.sqrt(np.where(price > 0, price, price.max(initial=0.0) or 1.0))
    needed = unit * distribute(tau, maps * unit, limit / unit[:, None])[0]
    effort = np.clip(needed, *limit.T)  # rounding of the units
    unique = bool(np.linalg.matrix_rank(maps[0]) == mechanism.n_u)
    return Holding(
        s=s,
        pose=pose,
        effort=effort,
        needed=needed,
        missed=tau[0] - maps[0] @ effort,
        slack=missed_rounding(limit),
        unique=unique,
        best=unique or set(objective.weights) <= SQUARES_AT_REST,
    )


def _figure(value: float) -> str:
    """Return a number with four digits, or one decimal if it is large: 120.0, 5.3, 0.145."""
    return f"{value:.1f}" if abs(value) >= 99.95 else f"{value:.4g}"


def unheld(problem: Problem, holding: Holding) -> tuple[str, dict[str, float]]:
    """Return a sentence on why no efforts within their limits hold a pose, with the needed effort and its limit."""
    mechanism, needed = problem.mechanism, holding.needed
    nearest = np.clip(needed, *effort_bounds(problem).T)
    j = int(np.argmax(np.abs(needed - nearest)))
    off = float(abs(needed[j] - nearest[j]))
    row = int(np.argmax(np.abs(holding.missed)))
    joint, missed = mechanism.independent_joints[row], float(holding.missed[row])
    lacking = f"{_figure(missed)} {joint.si_units[1]} on joint {joint.name}"
    if off > holding.slack and not holding.unique:
        sentence = f"holding the start needs {lacking} more than all actuators together give within their limits"
        return sentence, {"needed": missed, "limit": 0.0}
    if off > holding.slack:
        actuator = mechanism.actuators[j]
        sentence = (
            f"holding the start needs {actuator.name} on {actuator.target} to give {_figure(needed[j])} {actuator.unit},"
            f" {_figure(off)} {actuator.unit} beyond its limit of {_figure(nearest[j])} {actuator.unit}"
        )
        return sentence, {"needed": float(needed[j]), "limit": float(nearest[j])}
    sentence = f"the start is no equilibrium: no actuator can give the {lacking} needed to hold it"
    return sentence, {"needed": missed, "limit": 0.0}
