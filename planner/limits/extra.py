"""Users' own limits: rows at nodes, each in units of its larger bound."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import casadi as ca

from linkplan.models.poses.along import sampled
from linkplan.planner.limits.path_limit import (
    BETWEEN_NODES_FACTOR,
    Bounds,
    Instant,
    Margin,
    Measured,
    PathLimit,
    Poses,
    Problem,
    Samples,
    Scales,
    Tightened,
)
from linkplan.planner.problem.extra import Expression, ExtraLimit, expressed, uses
from linkplan.planner.problem.instant import free_instant


@dataclass(frozen=True, slots=True)
class ExtraPathLimit(PathLimit):
    """One of a problem's extra limits."""

    key: ClassVar[str] = "extra"
    words: ClassVar[str] = "the extra limit '{}'"
    row_kind: ClassVar[str] = "path"  # the effect of effort on it is unknown
    tightened: ClassVar[Tightened] = Tightened.IN_UNITS
    n_numbers: ClassVar[int] = 1
    item: int
    expression: Expression
    jumps_with_effort: bool = field()
    of_position: bool = field()
    extra: ExtraLimit = field(compare=False)

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        depends = [uses(one, problem.mechanism) for one in problem.extra_limits]
        return [
            cls(item, one.expression, of["u"], not of["v"] and not of["u"], one)
            for item, (one, of) in enumerate(zip(problem.extra_limits, depends, strict=True))
        ]

    def numbers(self, problem: Problem) -> Sequence[float]:
        return (problem.extra_limits[self.item].size,)

    def row(self, at: Instant, numbers: ca.SX) -> ca.SX:
        return expressed(self.extra, at) / numbers

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        limit = problem.extra_limits[self.item]
        return limit.lower / limit.size, limit.upper / limit.size

    def measured(self, at: Poses) -> Measured:
        limit = at.problem.extra_limits[self.item]
        motion = (at.q, at.v, at.a, at.u) if isinstance(at, Samples) else (at.q,)
        instant, symbols = free_instant(at.problem.mechanism)
        function = ca.Function("extra", symbols[: len(motion)], [ca.densify(expressed(self.extra, instant))])
        values = sampled(function, *motion).reshape(-1)
        return Measured(limit.name, values, (limit.lower, limit.upper), limit.unit, limit.size)

    @classmethod
    def scaled(cls, problem: Problem, factor: float) -> Problem:
        wider = tuple(
            replace(one, lower=one.lower - (factor - 1) * one.size, upper=one.upper + (factor - 1) * one.size)
            for one in problem.extra_limits
        )
        return replace(problem, extra_limits=wider)

    @classmethod
    def without(cls, problem: Problem) -> Problem:
        return replace(problem, extra_limits=())

    @classmethod
    def factor_of(cls, problem: Problem, over: list[Margin]) -> float | None:
        return 1 + BETWEEN_NODES_FACTOR * max(-m.left / problem.extra_limits[m.item].size for m in over)
