"""Limits on the pose: positions and speeds of joints, ranges of balls and tendons, singular poses.

Positions and speeds of independent joints are polynomials of the program, with bounded coefficients at every instant.
Dependent positions are unknowns at nodes, and dependent speeds are rows at nodes. The row of a ball joint of angle alpha is
sin^2(alpha / 2), as a share of its value at the largest angle. The row of a tendon is its length in units of its range's
width. The distance from singular poses is the determinant of each block of J_z, relative to home.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import joint_rates
from linkplan.planner.limits.bounds import Affine
from linkplan.planner.limits.limit import (
    RELAXED_FACTOR,
    Bounds,
    Claimed,
    Limit,
    LimitFacts,
    Measured,
    Rows,
    Tightened,
    WhichJoints,
    limited_joints,
    limited_rows,
    with_limits,
)
from linkplan.planner.limits.samples import Poses, Samples
from linkplan.planner.problem.instant import Instant, Scales
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory

# Largest allowed overrun of ranges [rad or m] and speeds [rad/s or m/s], due to the rounding of degrees.
RANGE_SLACK = 1e-9


@dataclass(frozen=True, slots=True)
class SingularMarginLimit(Limit):
    """The determinant of one block of J_z, for loops that close together.

    Its row is also imposed at prescribed poses, because otherwise continuation near the margin fails more often.
    """

    key: ClassVar[str] = "singular_margin"
    facts: ClassVar[LimitFacts] = LimitFacts(
        kind=key,
        words="the distance from a singular pose, relative to home,",
        beyond="short of",
        of_position=True,
        at_given_poses=True,
    )
    item: int

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        n_blocks = problem.mechanism.dynamics.block_singularity.numel_out(0)
        return [cls(block) for block in range(n_blocks)] if problem.limits.singular_margin > 0 else []

    @property
    def rows(self) -> Rows:
        return Rows(
            node=lambda at, numbers: at.of_pose("block_singularity")[self.item] * numbers,
            n_numbers=1,
            numbers=lambda problem: (1.0 / _blocks_at_home(problem.mechanism)[self.item],),
        )

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return problem.limits.singular_margin, np.inf

    def measured(self, at: Poses) -> Measured:
        bounds = (at.problem.limits.singular_margin, np.inf)
        return Measured(at.problem.mechanism.name, at.block_ratios[:, self.item], bounds)

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        at_home = float(_blocks_at_home(problem.mechanism)[self.item])
        yield Claimed(
            name=f"distance from a singular pose, block {self.item + 1}",
            unit="1",
            bounds=(problem.limits.singular_margin, np.inf),
            value=lambda at: at.of_pose("block_singularity")[self.item] / at_home,
            of_planned=True,
        )

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        return with_limits(problem, singular_margin=problem.limits.singular_margin * factor if np.isfinite(factor) else 0.0)


def _blocks_at_home(mechanism: Mechanism) -> np.ndarray:
    """Return the determinants (n_blocks,) of J_z's blocks at home."""
    return np.array(mechanism.dynamics.block_singularity(mechanism.home)).ravel()


@dataclass(frozen=True, slots=True)
class RangeLimit(Limit):
    """The range of one joint; `column` is its index among the independent joints if intervals have rows for it."""

    key: ClassVar[str] = "position"
    facts: ClassVar[LimitFacts] = LimitFacts(
        kind=key,
        words="joint {}",
        bound="the range of {}",
        verb="stands at",
        tightened=Tightened.IN_PROBLEM,
        of_position=True,
        in_phase_plane=True,
    )
    item: int
    column: int | None

    @classmethod
    def of(cls, problem: Problem, *, position_rows: WhichJoints = False, **_: bool) -> list[Self]:
        if position_rows:
            every = enumerate(problem.mechanism.independent)
            return [cls(int(joint), k) for k, joint in every if position_rows is True or k in position_rows]
        return [cls(joint, None) for joint in limited_rows(problem.limits.position)]

    @property
    def rows(self) -> Rows:
        return Rows() if self.column is None else Rows(interval=lambda _: ("position_columns", self.column))

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return tuple(problem.limits.position[self.item] / (1.0 if self.column is None else scales.position[self.column]))

    def measured(self, at: Poses) -> Measured:
        unit, span = at.problem.mechanism.joints[self.item].shown(1.0), float(np.ptp(at.problem.limits.position[self.item]))
        measured = measured_of_joint(self, at, "", at.q[:, self.item], at.coefficients("position", self.item))
        return replace(measured, size=unit * span if np.isfinite(span) else 0.0, slack=unit * RANGE_SLACK, pose_size=unit)

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        claim = claim_of_joint(self, problem, "", lambda at: at.q[self.item])
        yield replace(claim, of_planned=True, slack=(RANGE_SLACK, RANGE_SLACK))


@dataclass(frozen=True, slots=True)
class SpeedLimit(Limit):
    """The speed of one joint; `column` is its index among the independent joints, None for a dependent one."""

    key: ClassVar[str] = "speed"
    facts: ClassVar[LimitFacts] = LimitFacts(
        kind=key,
        words="the speed of joint {}",
        bound="the speed limit of {}",
        tightened=Tightened.LATER_IN_PROBLEM,
        in_phase_plane=True,
        followed_with=1,
    )
    item: int
    column: int | None = None

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        return [cls(*of) for of in limited_joints(problem, problem.limits.speed)]

    @property
    def rows(self) -> Rows:
        if self.column is None:
            return Rows(node=lambda at, _: at.units["time"] * at.joint_rates[self.item])
        return Rows(interval=lambda _: ("speed_columns", self.column))

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return bounds_of_joint(self, problem, scales, 1)

    def measured(self, at: Samples) -> Measured:
        unit, rates = at.problem.mechanism.joints[self.item].shown(1.0), at.joint_rates[:, self.item]
        measured = measured_of_joint(self, at, "/s", rates, at.coefficients("velocity", self.item))
        return replace(measured, slack=unit * RANGE_SLACK, pose_size=unit)

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        claim = claim_of_joint(self, problem, "/s", lambda at: at.rates[self.item])
        yield replace(claim, slack=(RANGE_SLACK, RANGE_SLACK))

    def affine(self, problem: Problem) -> Affine:
        mechanism, own = problem.mechanism, [self.item]
        return Affine(lambda q, v, *_: joint_rates(mechanism, q, v)[:, own], problem.limits.speed[self.item], of_speed=True)


def bounds_of_state(problem: Problem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return [low, high] of independent positions and of their speeds (n_s, 2), and of dependent positions (n_z, 2)."""
    mechanism, position = problem.mechanism, problem.limits.position
    return position[mechanism.independent], problem.limits.speed[mechanism.independent], position[mechanism.dependent]


def bounds_of_joint(limit: Any, problem: Problem, scales: Scales, order: int) -> Bounds:
    """Return the scaled bounds of a limit on a joint's derivative of an order; of its `column`, if it has one."""
    unit = 1.0 if limit.column is None else scales.position[limit.column]
    return tuple(getattr(problem.limits, limit.key)[limit.item] * (scales.time_s**order / unit))


def measured_of_joint(
    limit: Limit, at: Poses, per: str, values: np.ndarray, coefficients: np.ndarray | None = None
) -> Measured:
    """Return values (n,) of a joint, and their Bernstein coefficients, in its unit with `per`, such as "/s2"."""
    joint, bounds = at.problem.mechanism.joints[limit.item], getattr(at.problem.limits, limit.key)[limit.item]
    unit, own = joint.shown(1.0), None if coefficients is None else joint.shown(1.0) * coefficients
    return Measured(joint.name, unit * values, unit * bounds, joint.unit + per, coefficients=own)


def claim_of_joint(limit: Limit, problem: Problem, per: str, value: Callable[[Any], Any]) -> Claimed:
    """Return the claim of a limit on a joint, whose unit is followed by `per`."""
    joint, bounds = problem.mechanism.joints[limit.item], getattr(problem.limits, limit.key)[limit.item]
    name, unit = f"{limit.key} of {joint.name}", joint.unit + per
    return Claimed(name=name, unit=unit, bounds=bounds, value=value, per_unit=joint.shown(1.0))


def own_column(mechanism: Mechanism, j: int) -> int | None:
    """Return the independent column that an actuator drives directly, or None."""
    joint = mechanism.actuators[j].joint
    places = np.flatnonzero(mechanism.independent == joint) if joint is not None else []
    return int(places[0]) if len(places) else None


@dataclass(frozen=True, slots=True)
class BallLimit(Limit):
    """The angle of one ball joint."""

    key: ClassVar[str] = "ball"
    facts: ClassVar[LimitFacts] = LimitFacts(
        kind=key, words="the angle of ball joint {}", tightened=Tightened.SQUARED, of_position=True
    )
    item: int

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        return [cls(item) for item in range(len(problem.mechanism.balls))]

    @property
    def rows(self) -> Rows:
        def node(at: Instant, _: ca.SX) -> ca.SX:
            return at.of_pose("ball_turns")[self.item] / np.sin(at.mechanism.balls[self.item].largest / 2) ** 2

        return Rows(node=node)

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return -np.inf, 1.0

    def measured(self, at: Poses) -> Measured:
        ball, turns = at.problem.mechanism.balls[self.item], at.of_pose("ball_turns")[:, self.item]
        angles = np.degrees(2 * np.arcsin(np.sqrt(np.clip(turns, 0.0, 1.0))))
        return Measured(ball.name, angles, (-np.inf, np.degrees(ball.largest)), "deg")

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        ball = problem.mechanism.balls[self.item]
        yield Claimed(
            name=f"sin^2 of half the angle of ball joint {ball.name}",
            unit="1",
            bounds=(-np.inf, np.sin(ball.largest / 2) ** 2),
            value=lambda at: at.of_pose("ball_turns")[self.item],
            of_planned=True,
        )

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        balls = () if not np.isfinite(factor) else problem.mechanism.balls
        wider = tuple(replace(one, largest=min(np.pi, one.largest * factor)) for one in balls)
        return problem.varied(mechanism=replace(problem.mechanism, balls=wider))


@dataclass(frozen=True, slots=True)
class TendonLimit(Limit):
    """The length of one tendon."""

    key: ClassVar[str] = "tendon"
    facts: ClassVar[LimitFacts] = LimitFacts(
        kind=key, words="the length of tendon {}", tightened=Tightened.IN_UNITS, of_position=True, by_size=True
    )
    item: int

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        return [cls(item) for item in range(len(problem.mechanism.tendons))]

    @property
    def rows(self) -> Rows:
        def node(at: Instant, _: ca.SX) -> ca.SX:
            return at.of_pose("tendon_length")[self.item] / at.mechanism.tendons[self.item].span

        return Rows(node=node)

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        tendon = problem.mechanism.tendons[self.item]
        return tendon.low / tendon.span, tendon.high / tendon.span

    def measured(self, at: Poses) -> Measured:
        tendon, lengths = at.problem.mechanism.tendons[self.item], at.of_pose("tendon_length")[:, self.item]
        return Measured(tendon.name, lengths, (tendon.low, tendon.high), tendon.unit, tendon.span)

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        tendon = problem.mechanism.tendons[self.item]
        yield Claimed(
            name=f"length of tendon {tendon.name}",
            unit=tendon.unit,
            bounds=(tendon.low, tendon.high),
            value=lambda at: at.of_pose("tendon_length")[self.item],
            of_planned=True,
        )

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        more = min(factor - 1.0, RELAXED_FACTOR)
        longer = tuple(
            replace(one, low=one.low - more * one.span, high=one.high + more * one.span) for one in problem.mechanism.tendons
        )
        return problem.varied(mechanism=replace(problem.mechanism, tendons=longer))
