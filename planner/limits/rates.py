"""Limits on the accelerations and jerks of joints, and on the speeds, accelerations and jerks of sites.

Those of independent joints are polynomials of the program, whose coefficients are bounded at every instant. Those of
dependent joints and of sites are functions of the independent joints' motion. They are bounded at nodes, and at open ends if
they may jump there. If they are enclosed, the coefficients of the polynomials through the nodes' values are bounded instead.
Independent joints on whose jerk a limit depends have continuous accelerations (`bounds.linear_rows`), which are zero where
the motion begins or ends with the joint at rest.
"""

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import accelerations, jerks, joint_rates, sampled, site_motion
from linkplan.planner.limits.bounds import Affine
from linkplan.planner.limits.joints import bounds_of_joint, claim_of_joint, measured_of_joint
from linkplan.planner.limits.limit import (
    Bounds,
    Claimed,
    Limit,
    LimitFacts,
    Measured,
    Rows,
    Tightened,
    limited_joints,
    squared_claim,
)
from linkplan.planner.limits.samples import Samples
from linkplan.planner.problem.extra import jerk_of
from linkplan.planner.problem.instant import Instant, Scales, free_instant, jerk_columns, motion_symbols
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class AccelerationLimit(Limit):
    """The acceleration of one joint; `column` is its index among the independent joints, None for a dependent one.

    `jumps` tells whether the acceleration of a dependent joint may jump.
    """

    key: ClassVar[str] = "acceleration"
    item: int
    column: int | None = None
    jumps: bool = False
    enclosed: bool = False

    @classmethod
    def of(cls, problem: Problem, *, enclosed: bool = False, **_: bool) -> list[Self]:
        limited = limited_joints(problem, problem.limits.acceleration)
        return [
            cls(joint, column, column is None and not _is_smooth(problem, moving_joint, joint), enclosed)
            for joint, column in limited
        ]

    @property
    def facts(self) -> LimitFacts:
        return replace(_facts_of_joint(self.key, self.column, jumps=self.jumps), followed_with=1)

    @property
    def rows(self) -> Rows:
        if self.column is not None:
            return Rows(interval=lambda _: ("acceleration_columns", self.column))
        return rows_at_nodes(self, lambda at, _: at.units["time"] ** 2 * at.joint_accelerations[self.item])

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return bounds_of_joint(self, problem, scales, 2)

    def measured(self, at: Samples) -> Measured:
        own, mechanism = self.column is not None, at.problem.mechanism
        values = at.a[:, self.column] if own else accelerations(mechanism, at.q, at.v, at.a)[:, self.item]
        return measured_of_joint(self, at, "/s2", values)

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        yield claim_of_joint(self, problem, "/s2", lambda at: at.accelerations[self.item])

    def affine(self, problem: Problem) -> Affine:
        mechanism, own = problem.mechanism, [self.item]
        return Affine(lambda q, v, a, _: accelerations(mechanism, q, v, a)[:, own], problem.limits.acceleration[self.item])


@dataclass(frozen=True, slots=True)
class JerkLimit(Limit):
    """The jerk of one joint; `column` is as of `AccelerationLimit`, `moved_by` are the independent joints that move it."""

    key: ClassVar[str] = "jerk"
    item: int
    column: int | None
    moved_by: tuple[int, ...]
    enclosed: bool = False

    @classmethod
    def of(cls, problem: Problem, *, enclosed: bool = False, **_: bool) -> list[Self]:
        return [
            cls(joint, column, moving_joint(problem.mechanism, joint) if column is None else (column,), enclosed)
            for joint, column in limited_joints(problem, problem.limits.jerk)
        ]

    @property
    def facts(self) -> LimitFacts:
        return _facts_of_joint(self.key, self.column, jumps=True)

    @property
    def rows(self) -> Rows:
        if self.column is not None:
            return Rows(interval=lambda _: ("jerk_columns", self.column), jerk=self.moved_by)
        return rows_at_nodes(self, lambda at, _: at.units["time"] ** 3 * at.joint_jerks[self.item], self.moved_by)

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return bounds_of_joint(self, problem, scales, 3)

    def measured(self, at: Samples) -> Measured:
        own, mechanism = self.column is not None, at.problem.mechanism
        jerk = at.jerk[:, self.column] if own else jerks(mechanism, at.q, at.v, at.a, at.jerk)[:, self.item]
        jump = joint_rates(mechanism, at.q, at.acceleration_jumps)[:, self.item]  # Gamma a
        return measured_of_joint(self, at, "/s3", np.where(jump == 0, jerk, np.copysign(np.inf, jump)))

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        yield replace(claim_of_joint(self, problem, "/s3", lambda at: at.of_velocity.jerks[self.item]), of_planned=True)


@dataclass(frozen=True, slots=True)
class _SiteLimit(Limit):
    """The size of a site's speed, acceleration or jerk, its derivative by time of an `order` from 1 to 3.

    `site` is its index in the model. `jumps` is as of `AccelerationLimit`, `moved_by` as of `JerkLimit`.
    """

    order: ClassVar[int]
    item: int
    site: int
    jumps: bool = False
    moved_by: tuple[int, ...] | None = None
    enclosed: bool = False

    @classmethod
    def of(cls, problem: Problem, *, enclosed: bool = False, **_: bool) -> list[Self]:
        sites = [problem.mechanism.model.site(name).id for name in getattr(problem.limits, cls.key)]
        moving = [moving_site(problem.mechanism, site) if cls.order == 3 else None for site in sites]
        jumps = [cls.order == 3 or (cls.order == 2 and not _is_smooth(problem, moving_site, site)) for site in sites]
        return [cls(*one, enclosed) for one in zip(range(len(sites)), sites, jumps, moving, strict=True)]

    @property
    def facts(self) -> LimitFacts:
        followed = 1 if self.order < 3 else 0
        return LimitFacts(
            kind=self.key,
            words=f"the {self.what} of site {{}}",
            tightened=Tightened.SQUARED,
            enclosable=True,
            jumps_with_effort=self.jumps,
            in_phase_plane=self.order == 1,
            followed_with=followed,
        )

    @property
    def what(self) -> str:
        """The word for the derivative."""
        return ("speed", "acceleration", "jerk")[self.order - 1]

    def values(self, at: Instant) -> ca.SX:
        """Return the derivatives (3, n_sites) of all sites at an instant."""
        return getattr(at, ("site_velocities", "site_accelerations", "site_jerks")[self.order - 1])

    @property
    def rows(self) -> Rows:
        rows = rows_at_nodes(self, lambda at, share: self.values(at)[:, self.site] * share, self.moved_by, n_values=3)
        return replace(rows, n_numbers=1, numbers=lambda problem: (1.0 / self.most(problem)[1],))

    def most(self, problem: Problem) -> tuple[str, float]:
        """Return the site's name and its largest speed, acceleration or jerk [SI]."""
        return list(getattr(problem.limits, self.key).items())[self.item]

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return -np.inf, 1.0

    def measured(self, at: Samples) -> Measured:
        (name, most), mechanism = self.most(at.problem), at.problem.mechanism
        motion = (at.q, at.v, at.a, *([at.jerk] if self.order == 3 else []))
        values = np.linalg.norm(sampled(site_motion(mechanism, self.order), *motion)[:, :, self.site], axis=1)
        if self.order == 3:
            jumps = at.acceleration_jumps
            jump = sampled(site_motion(mechanism, 1), at.q, jumps, jumps)[:, :, self.site]
            values = np.where(np.any(jump, axis=1), np.inf, values)
        return Measured(name, values, (-np.inf, most), f"m/s{self.order if self.order > 1 else ''}")

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        at, symbols = free_instant(problem.mechanism)
        inputs = motion_symbols(at) if self.order == 3 else symbols[:4]
        (name, most), squared = self.most(problem), ca.densify(ca.sumsqr(self.values(at)[:, self.site]))
        unit = f"m2/s{2 * self.order}"
        yield squared_claim(f"{self.what} of site {name}", unit, most, ca.Function(self.key, inputs, [squared]))


@dataclass(frozen=True, slots=True)
class SiteSpeedLimit(_SiteLimit):
    """The speed of one site."""

    key: ClassVar[str] = "site_speed"
    order: ClassVar[int] = 1

    def affine(self, problem: Problem) -> Affine:
        motion, most = site_motion(problem.mechanism, 1), self.most(problem)[1]

        def along(q: np.ndarray, v: np.ndarray, a: np.ndarray, _: np.ndarray) -> np.ndarray:
            """Return the speed, which changes its sign between successive poses where the site turns back: no kink."""
            velocity = sampled(motion, q, v, a)[:, :, self.site]
            back = np.einsum("ki,ki->k", velocity[1:], velocity[:-1]) < 0
            sign = np.cumprod(np.append(1.0, np.where(back, -1.0, 1.0)))
            return (sign * np.linalg.norm(velocity, axis=1))[:, None]

        return Affine(along, (-most, most), of_speed=True)


@dataclass(frozen=True, slots=True)
class SiteAccelerationLimit(_SiteLimit):
    """The acceleration of one site."""

    key: ClassVar[str] = "site_acceleration"
    order: ClassVar[int] = 2

    def affine(self, problem: Problem) -> Affine:
        motion = site_motion(problem.mechanism, 2)
        bounds = -np.inf, self.most(problem)[1]
        return Affine(lambda q, v, a, _: sampled(motion, q, v, a)[:, :, self.site], bounds)


@dataclass(frozen=True, slots=True)
class SiteJerkLimit(_SiteLimit):
    """The jerk of one site."""

    key: ClassVar[str] = "site_jerk"
    order: ClassVar[int] = 3


def _facts_of_joint(key: str, column: int | None, *, jumps: bool) -> LimitFacts:
    words = f"the {key} of joint {{}}"
    if column is not None:
        return LimitFacts(kind=key, words=words, tightened=None, enclosable=True)
    return LimitFacts(kind=key, words=words, enclosable=True, jumps_with_effort=jumps)


def rows_at_nodes(
    limit: Any,
    values: Callable[[Instant, ca.SX], ca.SX],
    moved_by: tuple[int, ...] | None = None,
    *,
    n_values: int = 1,
) -> Rows:
    """Return the rows of a value at a node, or of the squared size of several (n_values,).

    If the limit is `enclosed`, they are rows on the polynomials through the nodes' values. `moved_by` are the coordinates on
    whose jerk the values depend; a jerk that no coordinate moves is zero.
    """
    if moved_by == ():
        return Rows(node=lambda *_: ca.SX(0))
    jerk, one = moved_by or (), n_values == 1
    if not limit.enclosed:
        return Rows(node=values if one else lambda at, numbers: ca.sumsqr(values(at, numbers)), jerk=jerk)
    return Rows(
        interval=lambda own: ("through_nodes", (limit.key, *own)) if one else ("squared_sums", (limit.key, own)),
        n_unknowns=n_values,
        unknowns=lambda at, numbers: (limit.key, ca.vertsplit(ca.densify(values(at, numbers)))),
        jerk=jerk,
    )


def smooth_columns(problem: Problem) -> tuple[int, ...]:
    """Return the independent coordinates whose accelerations have no jumps: a limit or a cost depends on their jerk."""
    mechanism = problem.mechanism
    if problem.objective.has("jerk"):
        return tuple(range(mechanism.dof))
    columns = [limit.moved_by or () for kind in (JerkLimit, SiteJerkLimit) for limit in kind.of(problem)]
    columns += [jerk_of(extra, mechanism) for extra in problem.extras]
    return tuple(sorted({column for some in columns for column in some}))


def _is_smooth(problem: Problem, moving: Callable[[Mechanism, int], tuple[int, ...]], item: int) -> bool:
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
