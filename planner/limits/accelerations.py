"""Limits on the acceleration of a joint or a site, and on the rate of change of a joint's, the jerk.

The accelerations of independent joints are polynomials of the program, whose coefficients are bounded at every instant; a
dependent joint's and a site's are bounded at nodes. A joint with a limit on jerk has a continuous acceleration
(`bounds.linear_rows`), which is zero where the motion begins or ends with the joint at rest.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.poses.along import accelerations, sampled, site_motion
from linkplan.planner.limits.limit import (
    Bounds,
    Claimed,
    Facts,
    Limit,
    Measured,
    Problem,
    Rows,
    Samples,
    Scales,
    Tightened,
    Trajectory,
    limited_joints,
    times,
    with_limits,
)
from linkplan.planner.problem.instant import free_instant
from linkplan.planner.transcription.bernstein import PiecewisePolynomial

# A change of acceleration from one interval to the next, or from rest, that is below this share of the largest acceleration
# is rounding and no jump.
_NO_JUMP_SHARE = 1e-7


@dataclass(frozen=True, slots=True)
class AccelerationLimit(Limit):
    """The acceleration of one joint; `column` is its index among the independent joints, None for a dependent one."""

    key: ClassVar[str] = "acceleration"
    item: int
    column: int | None = None

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        return [cls(*of) for of in limited_joints(problem, problem.limits.acceleration)]

    @property
    def facts(self) -> Facts:
        words = "the acceleration of joint {}"
        if self.column is not None:
            return Facts(kind=self.key, words=words, tightened=None)
        return Facts(kind=self.key, words=words, jumps_with_effort=True)

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
        return with_limits(problem, acceleration=times(problem.limits.acceleration, factor))


@dataclass(frozen=True, slots=True)
class JerkLimit(Limit):
    """The jerk of one independent joint; `column` is its index among these."""

    key: ClassVar[str] = "jerk"
    facts: ClassVar[Facts] = Facts(kind=key, words="the jerk of joint {}", tightened=None)
    item: int
    column: int

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        return [cls(joint, column) for joint, column in limited_joints(problem, problem.limits.jerk) if column is not None]

    @property
    def rows(self) -> Rows:
        return Rows(interval=lambda _: ("jerk_columns", self.column))

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return tuple(problem.limits.jerk[self.item] * scales.time_s**3 / scales.position[self.column])

    def measured(self, at: Samples) -> Measured:
        joint, bounds = at.problem.mechanism.joints[self.item], at.problem.limits.jerk[self.item]
        values = jerks(at.trajectory, at.time, jumps=True)[:, self.column]
        return Measured(joint.name, joint.shown(1.0) * values, joint.shown(1.0) * bounds, f"{joint.unit}/s3")

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        joint = problem.mechanism.joints[self.item]
        yield Claimed(
            name=f"jerk of {joint.name}",
            unit=f"{joint.unit}/s3",
            bounds=problem.limits.jerk[self.item],
            value=lambda at: at.rate * at.rate * at.v[self.column].derivative().derivative(),
            of_planned=True,
            per_unit=joint.shown(1.0),
        )

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        return with_limits(problem, jerk=times(problem.limits.jerk, factor))


@dataclass(frozen=True, slots=True)
class SiteAccelerationLimit(Limit):
    """The acceleration of one site, by its size; `site` is its index in the model."""

    key: ClassVar[str] = "site_acceleration"
    facts: ClassVar[Facts] = Facts(
        kind=key, words="the acceleration of site {}", tightened=Tightened.SQUARED, jumps_with_effort=True
    )
    item: int
    site: int

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        model = problem.mechanism.model
        return [cls(item, model.site(name).id) for item, name in enumerate(problem.limits.site_acceleration)]

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
        yield Claimed(
            name=f"squared acceleration of site {name}",
            unit="m2/s4",
            bounds=(-np.inf, most**2),
            value=ca.Function("site_acceleration", symbols[:4], [squared]),
            slack=(0.0, 2 * ROUNDING_SHARE * max(1.0, most) * most),
        )

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        limited = problem.limits.site_acceleration if np.isfinite(factor) else {}
        return with_limits(problem, site_acceleration={name: most * factor for name, most in limited.items()})

    def _limit(self, problem: Problem) -> tuple[str, float]:
        """Return the site's name and its largest acceleration [m/s2]."""
        return list(problem.limits.site_acceleration.items())[self.item]


def jerks(trajectory: Trajectory, time: np.ndarray, *, jumps: bool = False) -> np.ndarray:
    """Return the independent joints' jerk (n, n_s) [rad/s3 or m/s3] within the intervals.

    With `jumps`, the first sample after a jump of acceleration is infinite, with its sign. So is the first or last one of a
    motion that begins or ends at rest with an acceleration.
    """
    slope = PiecewisePolynomial(trajectory.velocity, trajectory.breaks_s).derivative()
    found = slope.derivative()(time)
    if not jumps:
        return found
    before, after = slope.coefficients[-1], slope.coefficients[0]  # (n, n_s) at the ends of the intervals
    if trajectory.periodic:
        steps = np.vstack([after - np.roll(before, 1, axis=0), np.zeros((1, trajectory.n_s))])
    else:
        still = [np.abs(v) <= 1e-9 * np.abs(trajectory.velocity).max() for v in trajectory.velocity[[0, -1], [0, -1]]]
        steps = np.vstack([still[0] * after[0], after[1:] - before[:-1], still[1] * -before[-1]])
    index = np.searchsorted(trajectory.breaks_s[1:-1], time, side="right")
    size = _NO_JUMP_SHARE * max(float(np.abs(slope.coefficients).max()), np.finfo(float).tiny)
    for k, j in zip(*np.nonzero(np.abs(steps) > size), strict=True):
        at = np.flatnonzero(index == k)[:1] if k < len(before) else [len(time) - 1]
        found[at, j] = np.inf * np.sign(steps[k, j])
    return found
