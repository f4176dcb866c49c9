"""Effort limits of machines at the corners of the ranges in [robust]: rows on the efforts that each machine needs."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca

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
from linkplan.planner.problem.robust import Corner, Robust


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

    def margin(self, samples: Samples) -> Margin:
        problem, actuator = samples.problem, samples.problem.mechanism.actuators[self.actuator]
        corner = self.corners[self.corner].description(tuple(joint.name for joint in problem.mechanism.joints))
        bounds = problem.robust.room * problem.limits.effort[self.actuator]
        values = samples.corner_efforts[:, self.corner, self.actuator]
        return margin_of(self, f"{actuator.name} with {corner}", values, bounds, actuator.unit, samples)

    @classmethod
    def scaled(cls, problem: Problem, factor: float) -> Problem:
        return replace(problem, robust=replace(problem.robust, room=factor * problem.robust.room))

    @classmethod
    def without(cls, problem: Problem) -> Problem:
        return replace(problem, robust=Robust())
