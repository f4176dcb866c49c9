"""The least distance from singular poses: a lower bound on the determinant of each block of J_z, relative to home."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.planner.limits.path_limit import (
    BETWEEN_NODES_FACTOR,
    Bounds,
    Instant,
    Margin,
    PathLimit,
    Problem,
    Samples,
    Scales,
    margin_of,
    with_limits,
)


@dataclass(frozen=True, slots=True)
class SingularMarginLimit(PathLimit):
    """The determinant of one block of J_z, for loops that close together."""

    key: ClassVar[str] = "singular_margin"
    words: ClassVar[str] = "the distance from a singular pose"
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

    def margin(self, samples: Samples) -> Margin:
        problem, bounds = samples.problem, (samples.problem.limits.singular_margin, np.inf)
        return margin_of(self, problem.mechanism.name, samples.block_ratios[:, self.item], bounds, "", samples)

    @classmethod
    def without(cls, problem: Problem) -> Problem:
        return with_limits(problem, singular_margin=0.0)

    @classmethod
    def factor_of(cls, problem: Problem, over: list[Margin]) -> float | None:
        return min(m.value / m.limit for m in over) / BETWEEN_NODES_FACTOR
