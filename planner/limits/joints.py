"""Limits on the pose: positions and speeds of joints, ranges of balls and tendons, pin forces, singular poses.

The certificate lists the margins of positions and speeds by joint. Positions and speeds of independent joints are
polynomials of the program, with bounded coefficients at every instant. Dependent positions are unknowns at nodes, and
dependent speeds are rows at nodes. A ball joint's row is sin^2(alpha / 2) of its angle alpha, relative to that of the
largest angle, and a tendon's its length in units of the range's width.

Pin forces are rows at nodes, or at every instant by Bernstein coefficients of the force's square. Rows at nodes alone allow
efforts that jump to exceed the limit between nodes, as for powers. At every instant the force is an algebraic unknown, a
polynomial through the nodes; its error between nodes decreases with the interval's width. The distance from singular poses
is the determinant of each block of J_z, relative to home.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled
from linkplan.planner.limits.path_limit import (
    BETWEEN_NODES_FACTOR,
    RELAXED_FACTOR,
    Bounds,
    Instant,
    Margin,
    Measured,
    MotionArrays,
    PathLimit,
    Poses,
    Problem,
    Samples,
    Scales,
    Tightened,
    limited_rows,
    with_limits,
)


@dataclass(frozen=True, slots=True)
class ClosureForceLimit(PathLimit):
    """The force of one closure, as a share of its rating; `rows` are its indices among all forces if it is an unknown."""

    key: ClassVar[str] = "closure_force"
    words: ClassVar[str] = "the closure force of {}"
    enclosable: ClassVar[bool] = True
    jumps_with_effort: ClassVar[bool] = True
    tightened: ClassVar[Tightened] = Tightened.SQUARED
    n_numbers: ClassVar[int] = 1
    item: int
    rows: tuple[int, ...] = ()

    @classmethod
    def of(cls, problem: Problem, *, enclosed: bool = False, **_: bool) -> list[Self]:
        limited = problem.limits.limited_closures
        places = {c: problem.mechanism.closure_slice(c) for c in limited}
        return [cls(c, tuple(range(places[c].start, places[c].stop)) if enclosed else ()) for c in limited]

    @property
    def at_nodes(self) -> bool:
        return not self.rows

    def numbers(self, problem: Problem) -> Sequence[float]:
        rating = problem.limits.closure_force[self.item]
        return (rating if self.rows else 1.0 / np.square(rating),)

    def row(self, at: Instant, numbers: ca.SX) -> ca.SX:
        return ca.sumsqr(at.closure_force[at.mechanism.closure_slice(self.item)]) * numbers

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return -np.inf, 1.0

    def interval_row(self, unknowns: tuple[int, ...]) -> tuple[str, Any] | None:
        return ("squared_sums", unknowns) if self.rows else None

    @property
    def n_unknowns(self) -> int:
        return len(self.rows)

    def unknowns(self, at: Instant, numbers: ca.SX) -> tuple[str, list[ca.SX]]:
        share = at.closure_force[list(self.rows)] / numbers
        return "bearing", ca.vertsplit(share)

    def start_of_unknowns(self, problem: Problem, scales: Scales, motion: MotionArrays) -> np.ndarray:
        force = sampled(problem.mechanism.dynamics.closure_force, *motion)[:, list(self.rows), 0]
        return force / problem.limits.closure_force[self.item]

    def measured(self, at: Samples) -> Measured:
        problem, c = at.problem, self.item
        bounds = (-np.inf, problem.limits.closure_force[c])
        return Measured(problem.mechanism.closure_names[c], at.closure_forces[:, c], bounds, "N")

    @classmethod
    def without(cls, problem: Problem) -> Problem:
        return with_limits(problem, closure_force=np.full(len(problem.limits.closure_force), np.inf))


@dataclass(frozen=True, slots=True)
class SingularMarginLimit(PathLimit):
    """The determinant of one block of J_z, for loops that close together.

    Its row binds at prescribed poses too: without it there, continuation next to the margin is lost more often.
    """

    key: ClassVar[str] = "singular_margin"
    words: ClassVar[str] = "the distance from a singular pose, relative to home,"
    beyond: ClassVar[str] = "short of"
    row_kind: ClassVar[str] = "singular"
    n_numbers: ClassVar[int] = 1
    item: int

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        n_blocks = problem.mechanism.dynamics.block_singularity.numel_out(0)
        return [cls(block) for block in range(n_blocks)] if problem.limits.singular_margin > 0 else []

    def numbers(self, problem: Problem) -> Sequence[float]:
        mechanism = problem.mechanism
        return (1.0 / np.array(mechanism.dynamics.block_singularity(mechanism.home)).ravel()[self.item],)

    def row(self, at: Instant, numbers: ca.SX) -> ca.SX:
        return at.of_pose("block_singularity")[self.item] * numbers

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return problem.limits.singular_margin, np.inf

    def measured(self, at: Poses) -> Measured:
        bounds = (at.problem.limits.singular_margin, np.inf)
        return Measured(at.problem.mechanism.name, at.block_ratios[:, self.item], bounds)

    @classmethod
    def without(cls, problem: Problem) -> Problem:
        return with_limits(problem, singular_margin=0.0)

    @classmethod
    def factor_of(cls, problem: Problem, over: list[Margin]) -> float | None:
        return min(m.value / m.limit for m in over) / BETWEEN_NODES_FACTOR


@dataclass(frozen=True, slots=True)
class RangeLimit(PathLimit):
    """The range of one joint; `column` is its index among the independent joints if intervals have rows for it."""

    key: ClassVar[str] = "position"
    words: ClassVar[str] = "joint {}"
    verb: ClassVar[str] = "stands at"
    of_position: ClassVar[bool] = True
    tightened: ClassVar[Tightened] = Tightened.IN_UNITS
    item: int
    column: int | None
    at_nodes: ClassVar[bool] = False

    @classmethod
    def of(cls, problem: Problem, *, position_rows: bool = False, **_: bool) -> list[Self]:
        if position_rows:
            return [cls(int(joint), column) for column, joint in enumerate(problem.mechanism.independent)]
        return [cls(joint, None) for joint in limited_rows(problem.limits.position)]

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return tuple(problem.limits.position[self.item] / scales.position[self.column])

    def interval_row(self, unknowns: tuple[int, ...]) -> tuple[str, Any] | None:
        return None if self.column is None else ("position_columns", self.column)

    def measured(self, at: Poses) -> Measured:
        joint = at.problem.mechanism.joints[self.item]
        unit, values, bounds = joint.shown(1.0), at.q[:, self.item], at.problem.limits.position[self.item]
        return Measured(joint.name, unit * values, unit * bounds, joint.unit, unit)


@dataclass(frozen=True, slots=True)
class SpeedLimit(PathLimit):
    """The speed of one joint; `column` is its index among the independent joints, None for a dependent one."""

    key: ClassVar[str] = "speed"
    words: ClassVar[str] = "the speed of joint {}"
    item: int
    column: int | None = None

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        limited, independent = limited_rows(problem.limits.speed), problem.mechanism.independent.tolist()
        own = [cls(joint, column) for column, joint in enumerate(independent) if joint in limited]
        return own + [cls(joint) for joint in limited if joint not in independent]

    @property
    def at_nodes(self) -> bool:
        return self.column is None

    def row(self, at: Instant, numbers: ca.SX) -> ca.SX:
        return at.units["time"] * at.joint_rates[self.item]

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        limit = problem.limits.speed[self.item]
        if self.column is None:
            return tuple(limit * scales.time_s)
        return tuple(limit / (scales.position[self.column] / scales.time_s))

    def interval_row(self, unknowns: tuple[int, ...]) -> tuple[str, Any] | None:
        return None if self.column is None else ("speed_columns", self.column)

    def measured(self, at: Samples) -> Measured:
        joint, bounds = at.problem.mechanism.joints[self.item], at.problem.limits.speed[self.item]
        unit = joint.shown(1.0)
        return Measured(joint.name, unit * at.joint_rates[:, self.item], unit * bounds, f"{joint.unit}/s")


def own_column(mechanism: Mechanism, j: int) -> int | None:
    """Return the independent column that an actuator drives directly, or None."""
    joint = mechanism.actuators[j].joint
    places = np.flatnonzero(mechanism.independent == joint) if joint is not None else []
    return int(places[0]) if len(places) else None


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

    def measured(self, at: Poses) -> Measured:
        ball, turns = at.problem.mechanism.balls[self.item], at.of_pose("ball_turns")[:, self.item]
        angles = np.degrees(2 * np.arcsin(np.sqrt(np.clip(turns, 0.0, 1.0))))
        return Measured(ball.name, angles, (-np.inf, np.degrees(ball.largest)), "deg")

    @classmethod
    def scaled(cls, problem: Problem, factor: float) -> Problem:
        wider = [replace(one, largest=min(np.pi, one.largest * factor)) for one in problem.mechanism.balls]
        return replace(problem, mechanism=replace(problem.mechanism, balls=tuple(wider)))

    @classmethod
    def without(cls, problem: Problem) -> Problem:
        return replace(problem, mechanism=replace(problem.mechanism, balls=()))


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

    def measured(self, at: Poses) -> Measured:
        tendon, lengths = at.problem.mechanism.tendons[self.item], at.of_pose("tendon_length")[:, self.item]
        return Measured(tendon.name, lengths, (tendon.low, tendon.high), tendon.unit, tendon.span)

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
