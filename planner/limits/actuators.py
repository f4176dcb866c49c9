"""Limits of actuators: power, the motor's torque-speed line, and a servo's ctrl.

Powers are rows at nodes, or at every instant by products of Bernstein coefficients of effort and speed. With rows at nodes
alone, an effort that jumps can exceed a limit on u w between nodes, even on fine meshes. A motor's line, |u / stall + w /
no_load| <= 1, is a row of intervals if the actuator drives a coordinate. A servo's ctrl range limits the ctrl of a planned
effort, except where the servo's force is clamped. The efforts at the corners of [robust] are those that each machine needs.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.models.actuation.actuators import Actuator, ranged_control
from linkplan.planner.limits.bounds import EffortBounds
from linkplan.planner.limits.joints import own_column
from linkplan.planner.limits.limit import (
    RELAXED_FACTOR,
    Bounds,
    Claimed,
    Limit,
    LimitFacts,
    Measured,
    Rows,
    Tightened,
    limited_rows,
)
from linkplan.planner.limits.samples import Samples, samples_of
from linkplan.planner.problem.instant import Instant, Scales
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory

# An effort within this share of the clamp of a servo's force counts as clamped, so that ctrl has no effect, because a motion
# may enter the clamp between two nodes (measured: 4e-5). Efforts between nodes may have errors 200 times as large
# (DYNAMICS_SHARE).
_CLAMPED_SHARE = 1e-4


@dataclass(frozen=True, slots=True)
class PowerLimit(Limit):
    """The power of one actuator, limited at nodes or at every instant.

    The speed of an actuator that drives a coordinate directly is that of the `column`, a polynomial of the program. The
    speed of any other is the sum of `levers`, each an algebraic unknown, times the columns' speeds.
    """

    key: ClassVar[str] = "power"
    facts: ClassVar[LimitFacts] = LimitFacts(
        kind=key,
        words="the power of {}",
        enclosable=True,
        enclosed_with_several=True,
        jumps_with_effort=True,
        followed_with=np.inf,
    )
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
    def rows(self) -> Rows:
        if self.column is not None:
            return Rows(interval=lambda _: ("power_columns", (self.item, self.column)))
        if not self.levers:
            return Rows(node=lambda at, _: at.u[self.item] * at.actuator_speeds[self.item] / at.units["power"])
        columns = list(self.levers)

        def unknowns(at: Instant, _: ca.SX) -> tuple[str, list[ca.SX]]:
            rate = at.units["position"] / at.units["time"]
            leverage = ca.diag(rate) @ at.of_pose("effort_map") @ ca.diag(at.units["effort"]) / at.units["power"]
            return "leverage", [leverage[s, self.item] for s in columns]

        return Rows(
            interval=lambda own: ("power_levers", (self.item, tuple(zip(own, columns, strict=True)))),
            n_unknowns=len(columns),
            unknowns=unknowns,
        )

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        unit = scales.power
        if self.column is not None:
            gear = problem.mechanism.actuators[self.item].gear
            unit = gear * scales.effort[self.item] * scales.position[self.column] / scales.time_s
        return tuple(np.sort(problem.limits.power[self.item] / unit))  # a negative gear exchanges the bounds

    def measured(self, at: Samples) -> Measured:
        j, problem = self.item, at.problem
        values = at.u[:, j] * at.actuator_speeds[:, j]
        return Measured(problem.mechanism.actuators[j].name, values, problem.limits.power[j], "W")

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        yield Claimed(
            name=f"power of {problem.mechanism.actuators[self.item].name}",
            unit="W",
            bounds=problem.limits.power[self.item],
            value=lambda at: at.state.u[self.item] * at.actuator_speeds[self.item],
        )

    @classmethod
    def effort_bounds(cls, problem: Problem) -> EffortBounds | None:
        power = problem.limits.power
        if not np.isfinite(power).any():
            return None

        def at(speed: np.ndarray, _: Any) -> tuple[np.ndarray, np.ndarray]:
            ends = np.sort(power / np.where(speed == 0, 1.0, speed)[..., None], axis=-1)
            return np.where(speed == 0, -np.inf, ends[..., 0]), np.where(speed == 0, np.inf, ends[..., 1])

        return EffortBounds(at=at, strength=np.full(len(power), np.inf))


@dataclass(frozen=True, slots=True)
class MotorLimit(Limit):
    """The line of one actuator's motor; `column` is the coordinate that it drives directly, if any."""

    key: ClassVar[str] = "motor"
    facts: ClassVar[LimitFacts] = LimitFacts(
        kind=key,
        words="the torque-speed line of {} (effort / stall + speed / no-load)",
        jumps_with_effort=True,
        followed_with=np.inf,
    )
    item: int
    column: int | None = None

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        lined = [j for j, motor in enumerate(problem.motors) if motor is not None and motor.line is not None]
        return [cls(j, own_column(problem.mechanism, j)) for j in lined]

    @property
    def rows(self) -> Rows:
        j, column = self.item, self.column

        def line(problem: Problem) -> tuple[float, float]:
            motor = problem.motors[j]
            return 1.0 / motor.stall_effort, 1.0 / motor.no_load_speed

        if column is None:
            return Rows(
                node=lambda at, numbers: numbers[0] * at.u[j] + numbers[1] * at.actuator_speeds[j],
                n_numbers=2,
                numbers=line,
            )

        def scaled(problem: Problem, scales: Scales) -> tuple[float, float]:
            (alpha, beta), gear = line(problem), problem.mechanism.actuators[j].gear
            return alpha * scales.effort[j], beta * gear * scales.position[column] / scales.time_s

        return Rows(interval=lambda _: ("motor_columns", (j, column)), interval_numbers=scaled)

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return -1.0, 1.0

    def measured(self, at: Samples) -> Measured:
        j, motor = self.item, at.problem.motors[self.item]
        values = at.u[:, j] / motor.stall_effort + at.actuator_speeds[:, j] / motor.no_load_speed
        return Measured(at.problem.mechanism.actuators[j].name, values, (-1.0, 1.0))

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        j, motor = self.item, problem.motors[self.item]
        yield Claimed(
            name=f"torque-speed line of {problem.mechanism.actuators[j].name}",
            unit="1",
            bounds=(-1.0, 1.0),
            value=lambda at: at.state.u[j] / motor.stall_effort + at.actuator_speeds[j] / motor.no_load_speed,
        )

    @classmethod
    def effort_bounds(cls, problem: Problem) -> EffortBounds | None:
        if not cls.of(problem):
            return None
        stall, no_load = motor_lines(problem).T

        def at(speed: np.ndarray, _: Any) -> tuple[np.ndarray, np.ndarray]:
            return -stall * (1.0 + speed / no_load), stall * (1.0 - speed / no_load)

        return EffortBounds(at=at, strength=stall, no_load_speed=lambda _: no_load, crosses_zero=True)

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        wider = tuple(one if one is None or one.line is None else one.with_line(factor) for one in problem.motors)
        return problem.varied(motors=wider)


@dataclass(frozen=True, slots=True)
class ControlLimit(Limit):
    """The ctrl of one servo."""

    key: ClassVar[str] = "control"
    facts: ClassVar[LimitFacts] = LimitFacts(
        kind=key,
        words="the ctrl of {}",
        tightened=Tightened.IN_UNITS,
        jumps_with_effort=True,
        narrows_efforts=True,
        followed_with=np.inf,
        by_size=True,
    )
    item: int

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        return [cls(j) for j, actuator in enumerate(problem.mechanism.actuators) if actuator.limits_control]

    @property
    def rows(self) -> Rows:
        def node(at: Instant, _: ca.SX) -> ca.SX:
            actuator, u = at.mechanism.actuators[self.item], at.u[self.item]
            ctrl = _ctrl(actuator, u, at.of_pose("actuator_length")[self.item], at.actuator_speeds[self.item])
            return ranged_control(actuator, ctrl, u, actuator.gain, ca.fmax) / _unit(actuator)

        return Rows(node=node)

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        actuator = problem.mechanism.actuators[self.item]
        return actuator.control_lower / _unit(actuator), actuator.control_upper / _unit(actuator)

    def measured(self, at: Samples) -> Measured:
        j, actuator = self.item, at.problem.mechanism.actuators[self.item]
        u, bounds = at.u[:, j], (actuator.control_lower, actuator.control_upper)
        ctrl = _ctrl(actuator, u, at.of_pose("actuator_length")[:, j], at.actuator_speeds[:, j])
        ranged, bent = _ranged(actuator, ctrl, u, len(at.points))
        return Measured(actuator.name, ranged, bounds, size=_unit(actuator), bent=bent)

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        yield control_claim(problem, trajectory, self.item)

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        """Return a problem with wider ranges of servos: both ends move outwards by `factor` - 1 of the larger end."""
        wider, share = list(problem.mechanism.actuators), min(factor, RELAXED_FACTOR) - 1
        for j in (limit.item for limit in cls.of(problem)):
            low, high, more = wider[j].control_lower, wider[j].control_upper, share * _unit(wider[j])
            wider[j] = replace(wider[j], control_lower=low - more, control_upper=high + more)
        return problem.varied(mechanism=replace(problem.mechanism, actuators=tuple(wider)))

    @classmethod
    def effort_bounds(cls, problem: Problem) -> EffortBounds | None:
        """Return the efforts at the ends of ctrlranges, u = g c + b_0 + b_1 l + b_2 w, within the servos' force clamps."""
        actuators = problem.mechanism.actuators
        still, by_length, by_speed = ends = np.zeros((3, len(actuators), 2))
        still[:] = -np.inf, np.inf
        for j in (limit.item for limit in cls.of(problem)):
            servo = actuators[j]
            ends[:, j] = np.array(servo.biases)[:, None]
            still[j] += np.sort(servo.gain * np.array([servo.control_lower, servo.control_upper]))
        if not np.isfinite(still).any():
            return None
        clamps = np.array([(servo.lower, servo.upper) for servo in actuators])

        def at(speed: np.ndarray, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            found = still + by_length * length[..., None] + by_speed * speed[..., None]
            return np.minimum(found[..., 0], clamps[:, 1]), np.maximum(found[..., 1], clamps[:, 0])

        def no_load_speed(length: np.ndarray) -> np.ndarray:
            with np.errstate(divide="ignore", invalid="ignore"):
                speed = np.abs((still + by_length * length[..., None]) / by_speed)
            return np.fmax(speed[..., 0], speed[..., 1])

        strength = np.full(len(actuators), np.inf)
        return EffortBounds(at=at, strength=strength, no_load_speed=no_load_speed, of_length=True, crosses_zero=True)


def _ctrl(actuator: Actuator, u: Any, length: Any, speed: Any) -> Any:
    """Return the ctrl with which a servo gives the effort u."""
    b = actuator.biases
    return (u - b[0] - b[1] * length - b[2] * speed) / actuator.gain


def motor_lines(problem: Problem) -> np.ndarray:
    """Return the stall efforts and no-load speeds (n_u, 2) of the motors' lines, infinite without one."""
    lines = [None if motor is None else motor.line for motor in problem.motors]
    return np.array([(np.inf, np.inf) if line is None else line for line in lines]).reshape(-1, 2)


def clamped_allowance(problem: Problem, motion: Trajectory, j: int) -> float:
    """Return the overrun of ctrl that is allowed along a motion; 0 if actuator j's force is nowhere clamped."""
    actuator = problem.mechanism.actuators[j]
    clamp = np.abs([end for end in (actuator.lower, actuator.upper) if np.isfinite(end)]).max(initial=0.0)
    if not (clamp and actuator.limits_control):
        return 0.0
    samples = samples_of(problem, motion)
    ctrl = _ctrl(actuator, samples.u[:, j], samples.of_pose("actuator_length")[:, j], samples.actuator_speeds[:, j])
    _, bent = _ranged(actuator, ctrl, samples.u[:, j], len(samples.points))
    return float(_CLAMPED_SHARE * clamp / abs(actuator.gain)) if bent.any() else 0.0


def control_claim(problem: Problem, trajectory: Trajectory, j: int) -> Claimed:
    """Return the claim that a ctrl in servo j's range gives its planned effort, unless its force is clamped anyway."""
    actuator = problem.mechanism.actuators[j]

    def ctrl(at: Any) -> Any:
        u, on = at.state.u[j], (1.0, at.state.of_pose("actuator_length")[j], at.actuator_speeds[j])
        gain, bias = (
            sum((c * x for c, x in zip(of, on, strict=True) if c), 0.0 * u) for of in (actuator.gains, actuator.biases)
        )
        return ranged_control(actuator, (u - bias) / gain, u, gain, at.state.larger)

    more = clamped_allowance(problem, trajectory, j) if actuator.has_length else 0.0
    return Claimed(
        name=f"ctrl of {actuator.name}",
        unit="",
        bounds=(actuator.control_lower, actuator.control_upper),
        value=ctrl,
        slack=(more, more) if more else None,
        unknown="" if actuator.has_length else "the model has no expression for its length",
    )


def further_control_claims(problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
    """Yield the claims on ctrls that the program does not limit, of servos with a variable gain or an unknown length."""
    for j, actuator in enumerate(problem.mechanism.actuators):
        ranged = np.isfinite((actuator.control_lower, actuator.control_upper)).any()
        if actuator.is_servo and ranged and not actuator.limits_control:
            yield control_claim(problem, trajectory, j)


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
