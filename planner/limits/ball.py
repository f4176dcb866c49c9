"""Ranges of ball joints: rows on sin^2(alpha / 2) of their angles alpha, relative to that of the largest angle."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.planner.limits.path_limit import (
    Bounds,
    Instant,
    Margin,
    PathLimit,
    Problem,
    Samples,
    Scales,
    Tightened,
    margin_of,
)


@dataclass(frozen=True, slots=True)
class BallLimit(PathLimit):
    """The angle of one ball joint."""

    key: ClassVar[str] = "ball"
    words: ClassVar[str] = "the angle of ball joint {}"
    of_position: ClassVar[bool] = True
    tightened: ClassVar[Tightened] = Tightened.SQUARED
    item: int

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        return [cls(item) for item in range(len(problem.mechanism.balls))]

    def row(self, at: Instant, numbers: ca.SX) -> ca.SX:
        return at.of_pose("ball_turns")[self.item] / np.sin(at.mechanism.balls[self.item].largest / 2) ** 2

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return -np.inf, 1.0

    def margin(self, samples: Samples) -> Margin:
        ball, turns = samples.problem.mechanism.balls[self.item], samples.of_pose("ball_turns")[:, self.item]
        angles = np.degrees(2 * np.arcsin(np.sqrt(np.clip(turns, 0.0, 1.0))))
        return margin_of(self, ball.name, angles, (-np.inf, np.degrees(ball.largest)), "deg", samples)

    @classmethod
    def scaled(cls, problem: Problem, factor: float) -> Problem:
        wider = [replace(one, largest=min(np.pi, one.largest * factor)) for one in problem.mechanism.balls]
        return replace(problem, mechanism=replace(problem.mechanism, balls=tuple(wider)))

    @classmethod
    def without(cls, problem: Problem) -> Problem:
        return replace(problem, mechanism=replace(problem.mechanism, balls=()))
