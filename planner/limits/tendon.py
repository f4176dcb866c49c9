"""Tendons' ranges: rows on their lengths, in units of the range's width."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca

from linkplan.planner.limits.path_limit import (
    BETWEEN_NODES_FACTOR,
    RELAXED_FACTOR,
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
class TendonLimit(PathLimit):
    """The length of one tendon."""

    key: ClassVar[str] = "tendon"
    words: ClassVar[str] = "the length of tendon {}"
    of_position: ClassVar[bool] = True
    tightened: ClassVar[Tightened] = Tightened.IN_UNITS
    item: int

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        return [cls(item) for item in range(len(problem.mechanism.tendons))]

    def row(self, at: Instant, numbers: ca.SX) -> ca.SX:
        return at.of_pose("tendon_length")[self.item] / at.mechanism.tendons[self.item].span

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        tendon = problem.mechanism.tendons[self.item]
        return tendon.low / tendon.span, tendon.high / tendon.span

    def margin(self, samples: Samples) -> Margin:
        tendon, lengths = samples.problem.mechanism.tendons[self.item], samples.of_pose("tendon_length")[:, self.item]
        return margin_of(self, tendon.name, lengths, (tendon.low, tendon.high), tendon.unit, samples, tendon.span)

    @classmethod
    def scaled(cls, problem: Problem, factor: float) -> Problem:
        longer = tuple(
            replace(one, low=one.low - (factor - 1) * one.span, high=one.high + (factor - 1) * one.span)
            for one in problem.mechanism.tendons
        )
        return replace(problem, mechanism=replace(problem.mechanism, tendons=longer))

    @classmethod
    def without(cls, problem: Problem) -> Problem:
        return cls.scaled(problem, 1.0 + RELAXED_FACTOR)

    @classmethod
    def factor_of(cls, problem: Problem, over: list[Margin]) -> float | None:
        return 1 + BETWEEN_NODES_FACTOR * max(-m.left / problem.mechanism.tendons[m.item].span for m in over)
