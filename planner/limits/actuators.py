"""Limits of actuators: effort rate, power, the motor's torque-speed line, a servo's ctrl, and efforts at corners.

Effort rates are rows on the coefficients of u', which hold at every instant. Powers are rows at nodes, or at every instant
by products of Bernstein coefficients of effort and speed: at nodes alone, a limit on u w lets an effort that jumps exceed it
between nodes, even on fine meshes. A motor's line, |u / stall + w / no_load| <= 1, is a row of intervals if the actuator
drives a coordinate. A servo's ctrl range limits the ctrl of a planned effort, except where the servo's force is clamped. The
efforts at the corners of [robust] are those that each machine there needs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.models.actuation.actuators import Actuator, ranged_control
from linkplan.models.poses.along import sampled
from linkplan.planner.limits.joints import own_column
from linkplan.planner.limits.path_limit import (
    BETWEEN_NODES_FACTOR,
    RELAXED_FACTOR,
    Bounds,
    Instant,
    Margin,
    Measured,
    MotionArrays,
    PathLimit,
    Problem,
    Samples,
    Scales,
    limited_rows,
    with_limits,
)
from linkplan.planner.limits.samples import samples_of
from linkplan.planner.problem.instant import Corner, Robust
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.bernstein import PiecewisePolynomial

# An effort within this share of the clamp of a servo's force counts as clamped, so ctrl has no effect: a motion may enter
# the clamp between two nodes. Efforts between nodes may be wrong by 200 times as much (DYNAMICS_SHARE). Measured: 4e-5.
_CLAMPED_SHARE = 1e-4


@dataclass(frozen=True, slots=True)
class EffortRateLimit(PathLimit):
    """The rate of one actuator's effort."""

    key: ClassVar[str] = "effort_rate"
    words: ClassVar[str] = "the effort rate of {}"
    item: int
    tightened: ClassVar[None] = None
    at_nodes: ClassVar[bool] = False

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        return [cls(j) for j in limited_rows(problem.limits.effort_rate)]

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return tuple(problem.limits.effort_rate[self.item] * scales.time_s / scales.effort[self.item])

    def interval_row(self, unknowns: tuple[int, ...]) -> tuple[str, Any]:
        return "rate_columns", self.item

    def measured(self, at: Samples) -> Measured:
        actuator, bounds = at.problem.mechanism.actuators[self.item], at.problem.limits.effort_rate[self.item]
        rate, jumps = effort_rates(at.trajectory, at.time)
        values = np.where(np.isnan(jumps[:, self.item]), rate[:, self.item], jumps[:, self.item])
        return Measured(actuator.name, values, bounds, f"{actuator.unit}/s")

    @classmethod
    def without(cls, problem: Problem) -> Problem:
        return cls.scaled(problem, RELAXED_FACTOR)

    def narrowed(self, problem: Problem, amount: float) -> Problem:
        rate = np.array(problem.limits.effort_rate)
        rate[self.item] += amount * np.array([1.0, -1.0])
        return with_limits(problem, effort_rate=rate)


def effort_rates(trajectory: Trajectory, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return u' (n, n_u) within intervals, and jumps (n, n_u): an infinite rate with the jump's sign after it, else NaN."""
    rate = PiecewisePolynomial(trajectory.effort, trajectory.breaks_s).derivative()(time)
    index = np.searchsorted(trajectory.breaks_s[1:-1], time, side="right")
    jumps = np.full((len(time), trajectory.n_u), np.nan)
    step = trajectory.effort[0, 1:] - trajectory.effort[-1, :-1]
    size = 1e-7 * max(float(np.abs(trajectory.effort).max()), np.finfo(float).tiny)
    for k, j in zip(*np.nonzero(np.abs(step) > size), strict=True):
        jumps[np.flatnonzero(index == k + 1)[:1], j] = np.inf * np.sign(step[k, j])
    return rate, jumps


@dataclass(frozen=True, slots=True)
class PowerLimit(PathLimit):
    """The power of one actuator, limited at nodes or at every instant.

    The speed of an actuator that drives a coordinate directly is that of the `column`, a polynomial of the program. The
    speed of any other is the sum of `levers`, each an algebraic unknown, times the columns' speeds.
    """

    key: ClassVar[str] = "power"
    words: ClassVar[str] = "the power of {}"
    enclosable: ClassVar[bool] = True
    jumps_with_effort: ClassVar[bool] = True
    item: int
    column: int | None = None
    levers: tuple[int, ...] = ()

    @classmethod
    def of(cls, problem: Problem, *, enclosed: bool = False, **_: bool) -> list[Self]:
        limited = limited_rows(problem.limits.power)
        if not enclosed:
            return [cls(j) for j in limited]
        own = {j: own_column(problem.mechanism, j) for j in limited}
        acts = problem.mechanism.dynamics.effort_map.sparsity_out(0)
        levers = {j: tuple(s for s in range(problem.mechanism.dof) if acts.has_nz(s, j)) for j in limited}
        columns = [cls(j, column) for j, column in own.items() if column is not None]
        return columns + [cls(j, None, levers[j]) for j, column in own.items() if column is None and levers[j]]

    @property
    def at_nodes(self) -> bool:
        return self.column is None and not self.levers

    def row(self, at: Instant, numbers: ca.SX) -> ca.SX:
        return at.u[self.item] * at.actuator_speeds[self.item] / at.units["power"]

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        unit = scales.power
        if self.column is not None:
            gear = problem.mechanism.actuators[self.item].gear
            unit = gear * scales.effort[self.item] * scales.position[self.column] / scales.time_s
        return tuple(np.sort(problem.limits.power[self.item] / unit))  # a negative gear exchanges the bounds

    def interval_row(self, unknowns: tuple[int, ...]) -> tuple[str, Any] | None:
        if self.column is not None:
            return "power_columns", (self.item, self.column)
        return ("power_levers", (self.item, tuple(zip(unknowns, self.levers, strict=True)))) if self.levers else None

    @property
    def n_unknowns(self) -> int:
        return len(self.levers)

    def unknowns(self, at: Instant, numbers: ca.SX) -> tuple[str, list[ca.SX]]:
        rate = at.units["position"] / at.units["time"]
        leverage = ca.diag(rate) @ at.of_pose("effort_map") @ ca.diag(at.units["effort"]) / at.units["power"]
        return "leverage", [leverage[s, self.item] for s in self.levers]

    def start_of_unknowns(self, problem: Problem, scales: Scales, motion: MotionArrays) -> np.ndarray:
        maps = sampled(problem.mechanism.dynamics.effort_map, motion[0])
        rate, columns = scales.position / scales.time_s, list(self.levers)
        return maps[:, columns, self.item] * scales.effort[self.item] * rate[columns] / scales.power

    def measured(self, at: Samples) -> Measured:
        j, problem = self.item, at.problem
        values = at.u[:, j] * at.actuator_speeds[:, j]
        return Measured(problem.mechanism.actuators[j].name, values, problem.limits.power[j], "W")


@dataclass(frozen=True, slots=True)
class MotorLimit(PathLimit):
    """The line of one actuator's motor; `column` is the coordinate that it drives directly, if any."""

    key: ClassVar[str] = "motor"
    words: ClassVar[str] = "the torque-speed line of {} (effort / stall + speed / no-load)"
    jumps_with_effort: ClassVar[bool] = True
    item: int
    column: int | None = None

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        lined = [j for j, motor in enumerate(problem.motors) if motor is not None and motor.line is not None]
        return [cls(j, own_column(problem.mechanism, j)) for j in lined]

    @property
    def at_nodes(self) -> bool:
        return self.column is None

    @property
    def n_numbers(self) -> int:
        return 2 if self.at_nodes else 0

    def numbers(self, problem: Problem) -> Sequence[float]:
        motor = problem.motors[self.item]
        return (1.0 / motor.stall_effort, 1.0 / motor.no_load_speed) if self.at_nodes else ()

    def row(self, at: Instant, numbers: ca.SX) -> ca.SX:
        return numbers[0] * at.u[self.item] + numbers[1] * at.actuator_speeds[self.item]

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return -1.0, 1.0

    def interval_row(self, unknowns: tuple[int, ...]) -> tuple[str, Any] | None:
        return None if self.column is None else ("motor_columns", (self.item, self.column))

    def interval_numbers(self, problem: Problem, scales: Scales) -> Sequence[float]:
        if self.column is None:
            return ()
        motor, gear = problem.motors[self.item], problem.mechanism.actuators[self.item].gear
        alpha, beta = 1.0 / motor.stall_effort, 1.0 / motor.no_load_speed
        return alpha * scales.effort[self.item], beta * gear * scales.position[self.column] / scales.time_s

    def measured(self, at: Samples) -> Measured:
        j, motor = self.item, at.problem.motors[self.item]
        values = at.u[:, j] / motor.stall_effort + at.actuator_speeds[:, j] / motor.no_load_speed
        return Measured(at.problem.mechanism.actuators[j].name, values, (-1.0, 1.0))

    @classmethod
    def scaled(cls, problem: Problem, factor: float) -> Problem:
        wider = tuple(
            m
            if m is None or m.line is None
            else replace(m, stall_effort=m.line[0] * factor, no_load_speed=m.line[1] * factor)
            for m in problem.motors
        )
        return replace(problem, motors=wider)

    @classmethod
    def without(cls, problem: Problem) -> Problem:
        bare = tuple(m and replace(m, stall_effort=None, no_load_speed=None) for m in problem.motors)
        return replace(problem, motors=bare)


@dataclass(frozen=True, slots=True)
class ControlLimit(PathLimit):
    """The ctrl of one servo."""

    key: ClassVar[str] = "control"
    words: ClassVar[str] = "the ctrl of {}"
    jumps_with_effort: ClassVar[bool] = True
    item: int

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        return [cls(j) for j, actuator in enumerate(problem.mechanism.actuators) if actuator.limits_control]

    def row(self, at: Instant, numbers: ca.SX) -> ca.SX:
        actuator, u = at.mechanism.actuators[self.item], at.u[self.item]
        ctrl = _ctrl(actuator, u, at.of_pose("actuator_length")[self.item], at.actuator_speeds[self.item])
        return ranged_control(actuator, ctrl, u, actuator.gain, ca.fmax) / _unit(actuator)

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        actuator = problem.mechanism.actuators[self.item]
        return actuator.control_lower / _unit(actuator), actuator.control_upper / _unit(actuator)

    def measured(self, at: Samples) -> Measured:
        j, actuator = self.item, at.problem.mechanism.actuators[self.item]
        u, bounds = at.u[:, j], (actuator.control_lower, actuator.control_upper)
        ctrl = _ctrl(actuator, u, at.of_pose("actuator_length")[:, j], at.actuator_speeds[:, j])
        ranged, bent = _ranged(actuator, ctrl, u, len(at.points))
        return Measured(actuator.name, ranged, bounds, bent=bent)

    @classmethod
    def scaled(cls, problem: Problem, factor: float) -> Problem:
        """Return a problem whose servos' ranges have both ends further out, by `factor` - 1 of the larger end."""
        wider = list(problem.mechanism.actuators)
        for j in (limit.item for limit in cls.of(problem)):
            low, high, more = wider[j].control_lower, wider[j].control_upper, (factor - 1) * _unit(wider[j])
            wider[j] = replace(wider[j], control_lower=low - more, control_upper=high + more)
        return replace(problem, mechanism=replace(problem.mechanism, actuators=tuple(wider)))

    @classmethod
    def without(cls, problem: Problem) -> Problem:
        return cls.scaled(problem, RELAXED_FACTOR)

    @classmethod
    def factor_of(cls, problem: Problem, over: list[Margin]) -> float | None:
        return 1 + BETWEEN_NODES_FACTOR * max(-m.left / _unit(problem.mechanism.actuators[m.item]) for m in over)


def _ctrl(actuator: Actuator, u: Any, length: Any, speed: Any) -> Any:
    """Return the ctrl with which a servo gives the effort u."""
    b = actuator.biases
    return (u - b[0] - b[1] * length - b[2] * speed) / actuator.gain


def clamped_allowance(problem: Problem, motion: Trajectory, j: int) -> float:
    """Return the overrun of ctrl that counts as clamped along a motion; 0 if actuator j's force is nowhere clamped."""
    actuator = problem.mechanism.actuators[j]
    clamp = np.abs([end for end in (actuator.lower, actuator.upper) if np.isfinite(end)]).max(initial=0.0)
    if not (clamp and actuator.limits_control):
        return 0.0
    samples = samples_of(problem, motion)
    ctrl = _ctrl(actuator, samples.u[:, j], samples.of_pose("actuator_length")[:, j], samples.actuator_speeds[:, j])
    _, bent = _ranged(actuator, ctrl, samples.u[:, j], len(samples.points))
    return float(_CLAMPED_SHARE * clamp / abs(actuator.gain)) if bent.any() else 0.0


def _unit(actuator: Actuator) -> float:
    """Return the unit of a servo's ctrl in the program: the larger end of its range."""
    ends = np.abs([actuator.control_lower, actuator.control_upper])
    return float(ends[np.isfinite(ends)].max(initial=0.0)) or 1.0


def _ranged(actuator: Actuator, ctrl: np.ndarray, u: np.ndarray, n_points: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the quantity limited by a servo's ctrlrange (n,), and a mask (n,) of samples with a clamped force."""
    ranged = ranged_control(actuator, ctrl, u, actuator.gain, np.maximum)
    bent = ranged != ctrl
    beside = np.repeat(bent.reshape(-1, n_points).any(axis=1), n_points)
    within = np.clip(ranged, actuator.control_lower, actuator.control_upper)
    clamp = np.abs([end for end in (actuator.lower, actuator.upper) if np.isfinite(end)]).max(initial=0.0)
    near = np.abs(ranged - within) * abs(actuator.gain) <= _CLAMPED_SHARE * clamp
    return np.where(beside & near, within, ranged), bent


@dataclass(frozen=True, slots=True)
class RobustLimit(PathLimit):
    """The effort of one actuator at one of the `corners`; `item` counts the actuators of the first corner, then the next."""

    key: ClassVar[str] = "robust"
    words: ClassVar[str] = "the effort of {}"
    jumps_with_effort: ClassVar[bool] = True
    item: int
    corners: tuple[Corner, ...]
    corner: int
    actuator: int

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        corners, n_u = problem.robust.corners, problem.mechanism.n_u
        return [cls(item, corners, item // n_u, item % n_u) for item in range(len(corners) * n_u)]

    def row(self, at: Instant, numbers: ca.SX) -> ca.SX:
        return at.corner_efforts(self.corners)[self.corner][self.actuator] / at.units["effort"][self.actuator]

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return tuple(problem.robust.room * problem.limits.effort[self.actuator] / scales.effort[self.actuator])

    def measured(self, at: Samples) -> Measured:
        problem, actuator = at.problem, at.problem.mechanism.actuators[self.actuator]
        corner = self.corners[self.corner].description(tuple(joint.name for joint in problem.mechanism.joints))
        bounds = problem.robust.room * problem.limits.effort[self.actuator]
        values = at.corner_efforts[:, self.corner, self.actuator]
        return Measured(f"{actuator.name} with {corner}", values, bounds, actuator.unit)

    @classmethod
    def scaled(cls, problem: Problem, factor: float) -> Problem:
        return replace(problem, robust=replace(problem.robust, room=factor * problem.robust.room))

    @classmethod
    def without(cls, problem: Problem) -> Problem:
        return replace(problem, robust=Robust())
