"""A user's own expression within bounds."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.planner.limits.limit import Bounds, Claimed, Limit, LimitFacts, Measured, Rows, Tightened
from linkplan.planner.limits.rates import rows_at_nodes, smooth_columns
from linkplan.planner.limits.samples import Poses, Samples
from linkplan.planner.problem.extra import Expression, ExtraLimit, expressed, extra_along, jerk_of, uses
from linkplan.planner.problem.instant import Scales, free_instant, motion_symbols
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class ExtraPathLimit(Limit):
    """One of a problem's extra limits."""

    key: ClassVar[str] = "extra"
    item: int
    expression: Expression
    jumps_with_effort: bool
    moved_by: tuple[int, ...]  # the independent joints on whose jerk it depends
    of_position: bool
    extra: ExtraLimit = field(compare=False)
    enclosed: bool = False

    @classmethod
    def of(cls, problem: Problem, *, enclosed: bool = False, **_: bool) -> list[Self]:
        if not problem.extra_limits:
            return []
        depends = [uses(one, problem.mechanism) for one in problem.extra_limits]
        jumps = len(smooth_columns(problem)) < problem.mechanism.dof  # accelerations
        return [
            cls(
                item,
                one.expression,
                of["u"] or of["j"] or (of["a"] and jumps),
                jerk_of(one, problem.mechanism),
                not (of["v"] or of["a"] or of["u"] or of["j"]),
                one,
                enclosed and of["j"],
            )
            for item, (one, of) in enumerate(zip(problem.extra_limits, depends, strict=True))
        ]

    @property
    def facts(self) -> LimitFacts:
        return LimitFacts(
            kind=self.key,
            words="the extra limit '{}'",
            tightened=Tightened.IN_UNITS,
            enclosable=bool(self.moved_by),
            jumps_with_effort=self.jumps_with_effort,
            of_position=self.of_position,
            second_order=True,  # unknown, so assumed: effort may act on it
            by_size=True,
        )

    @property
    def rows(self) -> Rows:
        rows = rows_at_nodes(self, lambda at, numbers: expressed(self.extra, at) / numbers, self.moved_by or None)
        return replace(rows, n_numbers=1, numbers=lambda problem: (problem.extra_limits[self.item].size,))

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        limit = problem.extra_limits[self.item]
        return limit.lower / limit.size, limit.upper / limit.size

    def measured(self, at: Poses) -> Measured:
        limit = at.problem.extra_limits[self.item]
        values = extra_along(self.extra, at.problem.mechanism, at.q, *(at.motion if isinstance(at, Samples) else ()))
        if self.moved_by:  # where accelerations jump, the jerk is infinite
            jumps = np.any(at.acceleration_jumps[:, self.moved_by], axis=1)
            values = np.where(jumps, np.inf if np.isfinite(limit.upper) else -np.inf, values)
        return Measured(limit.name, values, (limit.lower, limit.upper), limit.unit, limit.size)

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        at, _ = free_instant(problem.mechanism)
        limit = problem.extra_limits[self.item]
        value = ca.Function("extra", motion_symbols(at), [ca.densify(expressed(limit, at))])
        name, bounds = f"extra limit '{limit.name}'", (limit.lower, limit.upper)
        yield Claimed(name=name, unit=limit.unit, bounds=bounds, value=value)

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        if not np.isfinite(factor):
            return problem.varied(extra_limits=())
        wider = tuple(
            replace(one, lower=one.lower - (factor - 1) * one.size, upper=one.upper + (factor - 1) * one.size)
            for one in problem.extra_limits
        )
        return problem.varied(extra_limits=wider)
