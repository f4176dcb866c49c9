"""The kinds of limits, users' own limits, and the limits of a problem.

A new kind is one entry in each of the two tables.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import casadi as ca

from linkplan.models.poses.along import sampled
from linkplan.planner.limits.actuators import ControlLimit, EffortRateLimit, MotorLimit, PowerLimit, RobustLimit
from linkplan.planner.limits.joints import (
    BallLimit,
    ClosureForceLimit,
    RangeLimit,
    SingularMarginLimit,
    SpeedLimit,
    TendonLimit,
)
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
from linkplan.planner.limits.site import SitePathLimit
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


# In the order of their rows in a program.
KINDS: tuple[type[PathLimit], ...] = (
    RangeLimit,
    EffortRateLimit,
    SpeedLimit,
    MotorLimit,
    PowerLimit,
    ClosureForceLimit,
    SingularMarginLimit,
    ControlLimit,
    TendonLimit,
    BallLimit,
    RobustLimit,
    SitePathLimit,
    ExtraPathLimit,
)
# In the order in which a diagnosis removes them to find the one that forbids a motion. Effort limits and joint ranges follow
# after these.
RELAXED: tuple[type[PathLimit], ...] = (
    RobustLimit,
    SpeedLimit,
    PowerLimit,
    ClosureForceLimit,
    MotorLimit,
    ControlLimit,
    EffortRateLimit,
    SingularMarginLimit,
    TendonLimit,
    BallLimit,
    SitePathLimit,
    ExtraPathLimit,
)


def limits_of(problem: Problem, *, enclosed: bool = False, position_rows: bool = False) -> tuple[PathLimit, ...]:
    """Return a problem's limits; the arguments are those of `PathLimit.of`."""
    return tuple(limit for kind in KINDS for limit in kind.of(problem, enclosed=enclosed, position_rows=position_rows))


def relaxed_kinds(problem: Problem) -> list[type[PathLimit]]:
    """Return the kinds of limits of a problem that a diagnosis may remove, in its order."""
    return [kind for kind in RELAXED if kind.of(problem)]


def margins(samples: Samples) -> tuple[Margin, ...]:
    """Return the margins of all limits along a motion, except those on efforts and joints, which are listed by joint."""
    others = (limit for limit in limits_of(samples.problem) if not isinstance(limit, RangeLimit | SpeedLimit))
    found = [limit.margin(samples) for limit in others]
    return tuple(margin for margin in found if margin is not None)
