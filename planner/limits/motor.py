"""Motors' torque-speed lines, |u / stall + w / no_load| <= 1; rows of intervals if the actuator drives a coordinate."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import casadi as ca

from linkplan.planner.limits.joints import own_column
from linkplan.planner.limits.path_limit import (
    Bounds,
    Instant,
    Margin,
    PathLimit,
    Problem,
    Samples,
    Scales,
    margin_of,
)


@dataclass(frozen=True, slots=True)
class MotorLimit(PathLimit):
    """The line of one actuator's motor; `column` is the coordinate that it drives directly, if any."""

    key: ClassVar[str] = "motor"
    words: ClassVar[str] = "the torque-speed line of {}"
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

    def margin(self, samples: Samples) -> Margin:
        j, motor = self.item, samples.problem.motors[self.item]
        values = samples.u[:, j] / motor.stall_effort + samples.actuator_speeds[:, j] / motor.no_load_speed
        return margin_of(self, samples.problem.mechanism.actuators[j].name, values, (-1.0, 1.0), "", samples)

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
