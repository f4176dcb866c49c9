"""Limits on jerk, the rate of change of an acceleration: of a joint and of a site.

The jerks of independent joints are polynomials of the program, whose coefficients are bounded at every instant. Those of
dependent joints and of sites are functions of the independent joints' motion, and are bounded at nodes and at open ends.
Independent joints on whose jerk a limit depends have continuous accelerations (`bounds.linear_rows`), which are zero where
the motion begins or ends with the joint at rest.
"""

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import joint_jerk, joint_rates, sampled, site_motion
from linkplan.planner.limits.limit import (
    Bounds,
    Claimed,
    Instant,
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
from linkplan.planner.problem.extra import jerk_of
from linkplan.planner.problem.instant import free_instant, jerk_columns, motion_symbols


@dataclass(frozen=True, slots=True)
class JerkLimit(Limit):
    """The jerk of one joint; `column` is its index among the independent joints, None for a dependent one.

    `moved_by` are the independent joints that move it.
    """

    key: ClassVar[str] = "jerk"
    item: int
    column: int | None
    moved_by: tuple[int, ...]

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        return [
            cls(joint, column, moving_joint(problem.mechanism, joint) if column is None else (column,))
            for joint, column in limited_joints(problem, problem.limits.jerk)
        ]

    @property
    def facts(self) -> LimitFacts:
        words = "the jerk of joint {}"
        if self.column is not None:
            return LimitFacts(kind=self.key, words=words, tightened=None)
        return LimitFacts(kind=self.key, words=words, jumps_with_effort=True)

    @property
    def rows(self) -> Rows:
        if self.column is not None:
            return Rows(interval=lambda _: ("jerk_columns", self.column), jerk=self.moved_by)
        return _node_rows(self.moved_by, lambda at, _: at.units["time"] ** 3 * at.joint_jerks[self.item])

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        unit = 1.0 if self.column is None else scales.position[self.column]
        return tuple(problem.limits.jerk[self.item] * scales.time_s**3 / unit)

    def measured(self, at: Samples) -> Measured:
        mechanism, bounds = at.problem.mechanism, at.problem.limits.jerk[self.item]
        joint, own = mechanism.joints[self.item], self.column is not None
        jerk = at.jerk[:, self.column] if own else sampled(joint_jerk(mechanism), at.q, at.v, at.a, at.jerk)[:, self.item, 0]
        jump = joint_rates(mechanism, at.q, at.acceleration_jumps)[:, self.item]  # Gamma a
        values = np.where(jump == 0, joint.shown(1.0) * jerk, np.copysign(np.inf, jump))
        return Measured(joint.name, values, joint.shown(1.0) * bounds, f"{joint.unit}/s3")

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        joint = problem.mechanism.joints[self.item]
        yield Claimed(
            name=f"jerk of {joint.name}",
            unit=f"{joint.unit}/s3",
            bounds=problem.limits.jerk[self.item],
            value=lambda at: at.of_velocity.jerks[self.item],
            of_planned=True,
            per_unit=joint.shown(1.0),
        )

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        return with_limits(problem, jerk=scaled_bounds(problem.limits.jerk, factor))


@dataclass(frozen=True, slots=True)
class SiteJerkLimit(Limit):
    """The jerk of one site, by its size; `site` is its index in the model, `moved_by` as of `JerkLimit`."""

    key: ClassVar[str] = "site_jerk"
    facts: ClassVar[LimitFacts] = LimitFacts(
        kind=key, words="the jerk of site {}", tightened=Tightened.SQUARED, jumps_with_effort=True
    )
    item: int
    site: int
    moved_by: tuple[int, ...]

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        mechanism = problem.mechanism
        sites = [mechanism.model.site(name).id for name in problem.limits.site_jerk]
        return [cls(item, site, moving_site(mechanism, site)) for item, site in enumerate(sites)]

    @property
    def rows(self) -> Rows:
        rows = _node_rows(self.moved_by, lambda at, numbers: ca.sumsqr(at.site_jerks[:, self.site] * numbers))
        return replace(rows, n_numbers=1, numbers=lambda problem: (1.0 / self._limit(problem)[1],))

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return -np.inf, 1.0

    def measured(self, at: Samples) -> Measured:
        (name, most), mechanism, jumps = self._limit(at.problem), at.problem.mechanism, at.acceleration_jumps
        jerk = sampled(site_motion(mechanism, 3), at.q, at.v, at.a, at.jerk)[:, :, self.site]
        jump = sampled(site_motion(mechanism, 1), at.q, jumps, jumps)[:, :, self.site]
        values = np.where(np.any(jump, axis=1), np.inf, np.linalg.norm(jerk, axis=1))
        return Measured(name, values, (-np.inf, most), "m/s3")

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        name, most = self._limit(problem)
        at, _ = free_instant(problem.mechanism)
        squared = ca.densify(ca.sumsqr(at.site_jerks[:, self.site]))
        yield squared_claim(f"jerk of site {name}", "m2/s6", most, ca.Function("site_jerk", motion_symbols(at), [squared]))

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        return with_limits(problem, site_jerk=scaled_values(problem.limits.site_jerk, factor))

    def _limit(self, problem: Problem) -> tuple[str, float]:
        """Return the site's name and its largest jerk [m/s3]."""
        return list(problem.limits.site_jerk.items())[self.item]


def _node_rows(moved_by: tuple[int, ...], node: Callable[[Instant, ca.SX], ca.SX]) -> Rows:
    """Return the row of a jerk at a node; a joint or site that nothing moves has none, and the program no jerk for it."""
    return Rows(node=node, jerk=moved_by) if moved_by else Rows(node=lambda *_: ca.SX(0))


def smooth_columns(problem: Problem) -> tuple[int, ...]:
    """Return the independent coordinates whose accelerations have no jumps: a limit or a cost depends on their jerk."""
    mechanism = problem.mechanism
    if problem.objective.has("jerk"):
        return tuple(range(mechanism.dof))
    columns = [limit.moved_by for kind in (JerkLimit, SiteJerkLimit) for limit in kind.of(problem)]
    columns += [jerk_of(extra, mechanism) for extra in problem.extras]
    return tuple(sorted({column for some in columns for column in some}))


def is_smooth(problem: Problem, moving: Callable[[Mechanism, int], tuple[int, ...]], item: int) -> bool:
    """Check that the acceleration of a joint (of a site) has no jumps; `moving` is `moving_joint` (`moving_site`)."""
    smooth = smooth_columns(problem)
    return bool(smooth) and set(moving(problem.mechanism, item)) <= set(smooth)


@functools.lru_cache(maxsize=64)
def moving_joint(mechanism: Mechanism, joint: int) -> tuple[int, ...]:
    """Return the independent coordinates that move a joint."""
    at, _ = free_instant(mechanism)
    return jerk_columns(at, at.joint_jerks[joint])


@functools.lru_cache(maxsize=64)
def moving_site(mechanism: Mechanism, site: int) -> tuple[int, ...]:
    """Return the independent coordinates that move a site."""
    at, _ = free_instant(mechanism)
    return jerk_columns(at, at.site_jerks[:, site])
