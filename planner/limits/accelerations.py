"""Limits on the acceleration of a joint or a site.

The accelerations of independent joints are polynomials of the program, whose coefficients are bounded at every instant; a
dependent joint's and a site's are bounded at nodes, and at open ends if they may jump there.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.models.poses.along import accelerations, sampled, site_motion
from linkplan.planner.limits.jerks import is_smooth, moving_joint, moving_site
from linkplan.planner.limits.limit import (
    Bounds,
    Claimed,
    Limit,
    LimitFacts,
    Measured,
    Problem,
    Rows,
    Samples,
    Scales,
    Tightened,
    Trajectory,
    limited_joints,
    scaled_bounds,
    scaled_values,
    squared_claim,
    with_limits,
)
from linkplan.planner.problem.instant import free_instant


@dataclass(frozen=True, slots=True)
class AccelerationLimit(Limit):
    """The acceleration of one joint; `column` is its index among the independent joints, None for a dependent one.

    `jumps` tells whether the acceleration of a dependent joint may jump.
    """

    key: ClassVar[str] = "acceleration"
    item: int
    column: int | None = None
    jumps: bool = False

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        limited = limited_joints(problem, problem.limits.acceleration)
        return [
            cls(joint, column, column is None and not is_smooth(problem, moving_joint, joint)) for joint, column in limited
        ]

    @property
    def facts(self) -> LimitFacts:
        words = "the acceleration of joint {}"
        if self.column is not None:
            return LimitFacts(kind=self.key, words=words, tightened=None)
        return LimitFacts(kind=self.key, words=words, jumps_with_effort=self.jumps)

    @property
    def rows(self) -> Rows:
        if self.column is not None:
            return Rows(interval=lambda _: ("acceleration_columns", self.column))
        return Rows(node=lambda at, _: at.units["time"] ** 2 * at.joint_accelerations[self.item])

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        unit = 1.0 if self.column is None else scales.position[self.column]
        return tuple(problem.limits.acceleration[self.item] * scales.time_s**2 / unit)

    def measured(self, at: Samples) -> Measured:
        mechanism, bounds = at.problem.mechanism, at.problem.limits.acceleration[self.item]
        joint = mechanism.joints[self.item]
        own = self.column is not None
        values = at.a[:, self.column] if own else accelerations(mechanism, at.q, at.v, at.a)[:, self.item]
        return Measured(joint.name, joint.shown(1.0) * values, joint.shown(1.0) * bounds, f"{joint.unit}/s2")

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        joint = problem.mechanism.joints[self.item]
        yield Claimed(
            name=f"acceleration of {joint.name}",
            unit=f"{joint.unit}/s2",
            bounds=problem.limits.acceleration[self.item],
            value=lambda at: at.accelerations[self.item],
            per_unit=joint.shown(1.0),
        )

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        return with_limits(problem, acceleration=scaled_bounds(problem.limits.acceleration, factor))


@dataclass(frozen=True, slots=True)
class SiteAccelerationLimit(Limit):
    """The acceleration of one site, by its size; `site` is its index in the model, `jumps` as of `AccelerationLimit`."""

    key: ClassVar[str] = "site_acceleration"
    item: int
    site: int
    jumps: bool

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        sites = [problem.mechanism.model.site(name).id for name in problem.limits.site_acceleration]
        return [cls(item, site, not is_smooth(problem, moving_site, site)) for item, site in enumerate(sites)]

    @property
    def facts(self) -> LimitFacts:
        words, squared = "the acceleration of site {}", Tightened.SQUARED
        return LimitFacts(kind=self.key, words=words, tightened=squared, jumps_with_effort=self.jumps)

    @property
    def rows(self) -> Rows:
        return Rows(
            node=lambda at, numbers: ca.sumsqr(at.site_accelerations[:, self.site] * numbers),
            n_numbers=1,
            numbers=lambda problem: (1.0 / self._limit(problem)[1],),
        )

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return -np.inf, 1.0

    def measured(self, at: Samples) -> Measured:
        name, most = self._limit(at.problem)
        values = sampled(site_motion(at.problem.mechanism, 2), at.q, at.v, at.a)[:, :, self.site]
        return Measured(name, np.linalg.norm(values, axis=1), (-np.inf, most), "m/s2")

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        name, most = self._limit(problem)
        at, symbols = free_instant(problem.mechanism)
        squared = ca.densify(ca.sumsqr(at.site_accelerations[:, self.site]))
        yield squared_claim(
            f"acceleration of site {name}", "m2/s4", most, ca.Function("site_acceleration", symbols[:4], [squared])
        )

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        return with_limits(problem, site_acceleration=scaled_values(problem.limits.site_acceleration, factor))

    def _limit(self, problem: Problem) -> tuple[str, float]:
        """Return the site's name and its largest acceleration [m/s2]."""
        return list(problem.limits.site_acceleration.items())[self.item]
