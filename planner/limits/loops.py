"""Limits of kinematic loops: pin forces, and the least distance from singular poses.

Pin forces are rows at nodes, or at every instant by Bernstein coefficients of the force's square. Rows at nodes alone allow
efforts that jump to exceed the limit between nodes, as for powers. At every instant the force is an algebraic unknown, a
polynomial through the nodes; its error between nodes decreases with the interval's width. The distance from singular poses
is the determinant of each block of J_z, relative to home.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.models.poses.along import sampled
from linkplan.planner.limits.path_limit import (
    BETWEEN_NODES_FACTOR,
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
