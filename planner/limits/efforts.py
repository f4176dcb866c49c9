"""Limits on efforts: the effort of an actuator, its rate, and the efforts at the corners of [robust].

Efforts and their rates are polynomials with bounded coefficients, so that their limits hold at every instant. The efforts at
the corners of [robust] are those that each machine needs.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.models.actuation.distribution import ZERO_ARM_SHARE, missed_rounding
from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import demanded
from linkplan.models.poses.assembly import close_at
from linkplan.planner.limits.bounds import EffortBounds
from linkplan.planner.limits.limit import (
    RELAXED_FACTOR,
    Bounds,
    Claimed,
    Limit,
    LimitFacts,
    Measured,
    Rows,
    limited_rows,
    with_limits,
)
from linkplan.planner.limits.samples import Leverage, Samples, least_between, samples_for_claims
from linkplan.planner.problem.instant import Corner, Instant, Robust, Scales
from linkplan.planner.problem.limits import free_bounds
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import NO_JUMP_SHARE, Trajectory
from linkplan.planner.transcription.bernstein import PiecewisePolynomial

# Allowed overrun of the motion's effort by inverse dynamics, as a share of the limit. Proofs refuse larger overruns, and the
# planner refines meshes until the overrun is smaller.
INVERSE_DYNAMICS_SHARE = 2e-6
# Largest jump of an effort with a limited rate, as a share of the largest effort.
EFFORT_JUMP_SHARE = 1e-7


@dataclass(frozen=True, slots=True)
class EffortLimit(Limit):
    """The effort of one actuator; the bounds of the efforts' coefficients impose it at every instant."""

    key: ClassVar[str] = "effort"
    facts: ClassVar[LimitFacts] = LimitFacts(
        kind=key,
        words="the effort of {}",
        tightened=None,
        jumps_with_effort=True,
        in_phase_plane=True,
        of_planned_effort=True,
    )
    item: int

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        return [cls(j) for j in limited_rows(problem.limits.effort)]

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return tuple(problem.limits.effort[self.item] / scales.effort[self.item])

    @classmethod
    def effort_bounds(cls, problem: Problem) -> EffortBounds:
        low, high = problem.limits.effort.T
        strength = np.abs(problem.limits.effort).max(axis=1)
        return EffortBounds(at=lambda *_: (low, high), strength=strength, constant=True)

    def measured(self, at: Samples) -> Measured:
        actuator = at.problem.mechanism.actuators[self.item]
        bounds, coefficients = at.problem.limits.effort[self.item], at.trajectory.effort[:, :, self.item]
        slack, values = share_of(bounds, ROUNDING_SHARE), at.u[:, self.item]
        return Measured(actuator.name, values, bounds, actuator.unit, coefficients=coefficients, slack=slack)

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        actuator, bounds = problem.mechanism.actuators[self.item], problem.limits.effort[self.item]
        leverage = samples_for_claims(problem, trajectory).leverage
        yield Claimed(
            name=f"effort of {actuator.name} by inverse dynamics",
            unit=actuator.unit,
            bounds=bounds,
            value=lambda at: at.efforts(leverage=leverage)[self.item],
            slack=share_of(bounds, INVERSE_DYNAMICS_SHARE),
        )
        yield Claimed(
            name=f"planned effort of {actuator.name}",
            unit=actuator.unit,
            bounds=bounds,
            value=lambda at: at.u[self.item],
            of_planned=True,
            slack=share_of(bounds, ROUNDING_SHARE),
        )


def end_sizes(bounds: np.ndarray) -> np.ndarray:
    """Return the size of each end of limits (n, 2): of the other end if an end is zero, and zero if it is infinite."""
    sizes = np.where(np.isfinite(bounds), np.abs(bounds), 0.0)
    return np.where(np.isfinite(bounds) & (sizes == 0), sizes.max(axis=1, keepdims=True), sizes)


def within_efforts(problem: Problem, share: float) -> Problem:
    """Return a problem with a distance, a share of each end, from the limits on efforts that are wider than ten of it."""
    ends = problem.limits.effort
    distance = share * end_sizes(ends) * [1.0, -1.0]
    wide = np.ptp(ends, axis=1, keepdims=True) > 10.0 * np.abs(distance).max(axis=1, keepdims=True)
    return with_limits(problem, effort=ends + np.where(wide, distance, 0.0))


def share_of(bounds: np.ndarray, share: float) -> tuple[float, float]:
    """Return the allowances of [low, high]: a share of each end, or of the other end if an end is zero."""
    low, high = share * end_sizes(np.reshape(bounds, (1, 2)))[0]
    return float(low), float(high)


def effort_overrun(samples: Samples) -> tuple[np.ndarray, str]:
    """Return the overruns (n_intervals,) of efforts by inverse dynamics, and a sentence if they are not allowed.

    Overruns are shares of the allowance, and are also looked for between the samples.
    """
    needed, limit, n = samples.needed_efforts, samples.problem.limits.effort, len(samples.points)
    allowances = np.maximum(INVERSE_DYNAMICS_SHARE * end_sizes(limit), 1e-12)
    inside = np.stack([needed - limit[:, 0], limit[:, 1] - needed], axis=-1)  # (kinetics, sample, motor, 2)
    left = np.divide(inside, allowances, out=np.zeros_like(inside), where=np.isfinite(inside))
    left = np.moveaxis(left, 1, -1).reshape(len(needed), *limit.shape, -1, n)  # by interval and point at last
    least = least_between(left, samples.points).reshape(left.shape[:-1])
    worst = np.unravel_index(int(np.argmin(least)), least.shape)
    overrun = -least.min(axis=(0, 1, 2), initial=0.0)
    if not least[worst] < -1.0:
        return overrun, ""
    _, j, end, interval = worst
    actuator, bound, over = samples.problem.mechanism.actuators[j], limit[j, end], -least[worst] * allowances[j, end]
    time_s = float(samples.time.reshape(-1, n)[interval, int(np.argmin(left[worst]))])
    return overrun, (
        f"between nodes the motion needs {bound + (over if end else -over):.9g} {actuator.unit} of '{actuator.name}' at"
        f" t = {time_s:.4g} s, {over:.3g} {actuator.unit} beyond its limit (allowed: {allowances[j, end]:.3g})"
        f"{dead_centre_words(samples, time_s)}"
    )


def dead_centre_words(samples: Samples, time_s: float) -> str:
    """Return a phrase that names a dead centre near a time of the samples; empty if there is none."""
    at = int(np.argmin(np.abs(samples.time - time_s)))
    if samples.leverage.transmission(samples.demanded[1][[at]])[0] > 10 * samples.leverage.least:
        return ""
    names = " and ".join(f"'{actuator.name}'" for actuator in samples.problem.mechanism.actuators)
    return f"; {names} {'is' if len(samples.problem.mechanism.actuators) == 1 else 'are'} near a dead centre there"


@dataclass(frozen=True, slots=True)
class EffortRateLimit(Limit):
    """The rate of one actuator's effort."""

    key: ClassVar[str] = "effort_rate"
    facts: ClassVar[LimitFacts] = LimitFacts(kind=key, words="the effort rate of {}", tightened=None)
    item: int

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        return [cls(j) for j in limited_rows(problem.limits.effort_rate)]

    @property
    def rows(self) -> Rows:
        return Rows(interval=lambda _: ("rate_columns", self.item))

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return tuple(problem.limits.effort_rate[self.item] * scales.time_s / scales.effort[self.item])

    def measured(self, at: Samples) -> Measured:
        actuator, bounds = at.problem.mechanism.actuators[self.item], at.problem.limits.effort_rate[self.item]
        rate, jumps = effort_rates(at.trajectory, at.time)
        values = np.where(np.isnan(jumps[:, self.item]), rate[:, self.item], jumps[:, self.item])
        # An effort has jumped at a start or goal at rest that it does not hold, and at a start with another effort before.
        jumped = np.array(rest_jumps(at.problem, at.trajectory)) > NO_JUMP_SHARE
        jumped[0] &= not np.isfinite(at.problem.limits.initial_effort[self.item, 0])
        jumped |= ends_off(at.problem, at.trajectory)[:, self.item] > _jump_size(at.trajectory)
        values[[0, -1]] = np.where(jumped, np.inf, values[[0, -1]])
        return Measured(actuator.name, values, bounds, f"{actuator.unit}/s")

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        actuator = problem.mechanism.actuators[self.item]
        yield Claimed(
            name=f"effort rate of {actuator.name}",
            unit=f"{actuator.unit}/s",
            bounds=problem.limits.effort_rate[self.item],
            value=lambda at: at.rate * at.u[self.item].derivative(),
            of_planned=True,
        )

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        return with_limits(problem, effort_rate=problem.limits.effort_rate * min(factor, RELAXED_FACTOR))


def holds_at_rest(problem: Problem, end: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return for start and goal the weighted sums of accelerations, as weights (n, n_s), that are zero there at rest.

    An effort with a limited rate holds a rest, except an initial effort that is given, so that only the other efforts
    accelerate the mechanism. A goal whose pose is free is that where the motion ends, `end` (n_s,). Without it the sums are
    known only if the rates of all efforts are limited.
    """
    mechanism, motion, limits = problem.mechanism, problem.motion, problem.limits
    limited = np.any(np.isfinite(limits.effort_rate), axis=1)
    if motion.kind != "reach" or mechanism.n_u < mechanism.dof or not limited.any():
        return np.zeros((0, mechanism.dof)), np.zeros((0, mechanism.dof))
    given = np.any(np.isfinite(limits.initial_effort), axis=1)
    goal = end if motion.goal_is_free else motion.goal
    return _held_sums(mechanism, motion.start, limited & ~given), _held_sums(mechanism, goal, limited)


def hold_a_free_goal(problem: Problem) -> list[int]:
    """Return the actuators whose efforts hold the goal at rest in a pose that is not known before, but not all of them.

    Each has the effort of its own that holds the pose, because there are as many actuators as freedoms.
    """
    motion, mechanism = problem.motion, problem.mechanism
    limited = np.any(np.isfinite(problem.limits.effort_rate), axis=1)
    rests = motion.goal_speed is None or not np.any(motion.goal_speed)
    asked = motion.kind == "reach" and motion.goal_is_free and rests and mechanism.n_u == mechanism.dof
    return np.flatnonzero(limited).tolist() if asked and not limited.all() else []


def _held_sums(mechanism: Mechanism, s: np.ndarray | None, holding: np.ndarray) -> np.ndarray:
    """Return the sums of accelerations, as weights (n, n_s), that are zero at s (n_s,) if some actuators (n_u,) hold it."""
    if holding.all():
        return np.eye(mechanism.dof)
    if s is None or not holding.any():
        return np.zeros((0, mechanism.dof))
    import scipy

    pose = close_at(mechanism, s)
    arms = np.array(mechanism.dynamics.effort_map(pose))
    unmoved = scipy.linalg.null_space(arms[:, ~holding].T, rcond=ZERO_ARM_SHARE)
    return unmoved.T @ np.array(mechanism.dynamics.reduced_inertia(pose))


def end_efforts(problem: Problem) -> np.ndarray:
    """Return [low, high] (2, n_u, 2) of the first and the last efforts: those that are given, and parts that hold a rest.

    Where there are more actuators than freedoms, an effort with a limited rate holds a part of the weight, and those
    without a limit must be able to hold the remainder.
    """
    mechanism, motion, limits = problem.mechanism, problem.motion, problem.limits
    found = np.stack([limits.initial_effort, free_bounds(mechanism.n_u)])
    limited = np.any(np.isfinite(limits.effort_rate), axis=1)
    if motion.kind != "reach" or mechanism.n_u <= mechanism.dof or limited.all() or mechanism.forces is not None:
        return found
    ends = (motion.start, motion.start_speed), (None if motion.goal_is_free else motion.goal, motion.goal_speed)
    import scipy

    for bounds, (s, speed) in zip(found, ends, strict=True):
        if s is None or np.isfinite(bounds).any() or (speed is not None and np.any(speed)):
            continue
        still = np.zeros((1, mechanism.dof))
        (tau,), (arms,) = demanded(mechanism, close_at(mechanism, s)[None], still, still)
        for j in np.flatnonzero(limited):
            part = np.eye(mechanism.n_u)[j]
            holding = [scipy.optimize.linprog(way * part, A_eq=arms, b_eq=tau, bounds=limits.effort) for way in (1, -1)]
            if all(one.success for one in holding) and np.ptp([one.x[j] for one in holding]) > missed_rounding(
                limits.effort
            ):
                bounds[j] = [one.x[j] for one in holding]  # without a span the accelerations determine it
    return found


def ends_off(problem: Problem, trajectory: Trajectory) -> np.ndarray:
    """Return the distances (2, n_u) of the first and the last efforts from their bounds."""
    low, high = np.moveaxis(end_efforts(problem), -1, 0)
    efforts = trajectory.effort[[0, -1], [0, -1]]
    return np.maximum(np.maximum(low - efforts, efforts - high), 0.0)


def rest_jumps(problem: Problem, trajectory: Trajectory) -> tuple[float, float]:
    """Return the accelerations at start and goal that efforts which hold there forbid, as shares of the largest one."""
    ends = trajectory.acceleration_jumps()[[0, -1]]
    size = max(float(np.abs(trajectory.acceleration_at(trajectory.dense_times(4))).max()), float(np.finfo(float).tiny))
    start, goal = (
        float((np.abs(sums @ end) / np.abs(sums).sum(axis=1)).max(initial=0.0)) / size
        for sums, end in zip(holds_at_rest(problem, trajectory.position[-1, -1]), ends, strict=True)
    )
    return start, goal


def effort_rates(trajectory: Trajectory, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return u' (n, n_u) within intervals, and jumps (n, n_u): infinite with the jump's sign after a jump, else NaN."""
    rate = PiecewisePolynomial(trajectory.effort, trajectory.breaks_s).derivative()(time)
    index = np.searchsorted(trajectory.breaks_s[1:-1], time, side="right")
    jumps = np.full((len(time), trajectory.n_u), np.nan)
    step = trajectory.effort[0, 1:] - trajectory.effort[-1, :-1]
    for k, j in zip(*np.nonzero(np.abs(step) > _jump_size(trajectory)), strict=True):
        jumps[np.flatnonzero(index == k + 1)[:1], j] = np.inf * np.sign(step[k, j])
    return rate, jumps


def _jump_size(trajectory: Trajectory) -> float:
    """Return the largest change of effort that is due to rounding."""
    return EFFORT_JUMP_SHARE * max(float(np.abs(trajectory.effort).max()), np.finfo(float).tiny)


@dataclass(frozen=True, slots=True)
class RobustLimit(Limit):
    """The effort of one actuator at one of the `corners`; `item` counts the actuators of the first corner, then the next.

    If it is `implied` by the effort at another corner, the program needs no row for it.
    """

    key: ClassVar[str] = "robust"
    facts: ClassVar[LimitFacts] = LimitFacts(kind=key, words="the effort of {}", jumps_with_effort=True)
    item: int
    corners: tuple[Corner, ...]
    corner: int
    actuator: int
    implied: bool

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        corners, n_u = problem.robust.corners, problem.mechanism.n_u
        limited = limited_rows(problem.limits.effort)
        every = [(k, j) for k in range(len(corners)) for j in limited]
        return [cls(n_u * k + j, corners, k, j, _is_implied(problem, corners[k], j)) for k, j in every]

    @property
    def rows(self) -> Rows:
        if self.implied:
            return Rows()

        def node(at: Instant, _: ca.SX) -> ca.SX:
            return at.corner_efforts(self.corners)[self.corner][self.actuator] / at.units["effort"][self.actuator]

        return Rows(node=node)

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return tuple(self._limit(problem) / scales.effort[self.actuator])

    def measured(self, at: Samples) -> Measured:
        values, actuator = at.corner_efforts[:, self.corner, self.actuator], at.problem.mechanism.actuators[self.actuator]
        limit = self._limit(at.problem)
        # With several degrees of freedom the allowance is that of the proof. With only one degree of freedom, plans satisfy
        # the limit itself.
        slack = min(share_of(limit, INVERSE_DYNAMICS_SHARE)) if at.problem.mechanism.dof > 1 else None
        return Measured(self._name(at.problem), values, limit, actuator.unit, slack=slack)

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        leverage = leverage_at_dead_centres(problem, trajectory)
        yield Claimed(
            name=f"effort of {self._name(problem)}",
            unit=problem.mechanism.actuators[self.actuator].unit,
            bounds=self._limit(problem),
            value=lambda at: at.efforts(self.corners[self.corner], leverage)[self.actuator],
            slack=share_of(self._limit(problem), INVERSE_DYNAMICS_SHARE),
        )

    def _limit(self, problem: Problem) -> np.ndarray:
        return problem.robust.room * problem.limits.effort[self.actuator]

    def _name(self, problem: Problem) -> str:
        return f"{problem.mechanism.actuators[self.actuator].name} with {self.corners[self.corner].description}"

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        if not np.isfinite(factor):
            return problem.varied(robust=Robust())
        return problem.varied(robust=problem.robust.replace(room=factor * problem.robust.room))


def leverage_at_dead_centres(problem: Problem, trajectory: Trajectory) -> Leverage | None:
    """Return the leverage of a motion that passes a dead centre; None for any other."""
    samples = samples_for_claims(problem, trajectory)
    return samples.leverage if samples.at_dead_centre.any() else None


def lacking_corner_claims(problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
    """Yield the claims that planned efforts suffice at dead centres for the machines at the corners of [robust]."""
    leverage = leverage_at_dead_centres(problem, trajectory) if problem.robust.corners else None
    if leverage is None:
        return
    allowed = samples_for_claims(problem, trajectory).corner_allowed
    for corner in problem.robust.corners:
        for i, joint in enumerate(problem.mechanism.independent_joints):
            yield Claimed(
                name=f"effort on {joint.name} that planned efforts lack at a dead centre with {corner.description}",
                unit=joint.si_units[1],
                bounds=(0.0, 0.0),
                value=lambda at, corner=corner, i=i: at.lacking(corner, leverage)[i],
                slack=(allowed, allowed),
            )


def _is_implied(problem: Problem, corner: Corner, actuator: int) -> bool:
    """Check if the effort limit at a corner follows from that of the same machine with smaller torque constants.

    The effort is inversely proportional to the torque constant's factor if there is one actuator for each freedom.
    """
    low, high = problem.limits.effort[actuator]
    if problem.mechanism.n_u != problem.mechanism.dof or not low <= 0 <= high:
        return False
    weaker = [other for other in (Corner(), *problem.robust.corners) if other.torque_factor < corner.torque_factor]
    return any(replace(other, torque_factor=corner.torque_factor) == corner for other in weaker)
