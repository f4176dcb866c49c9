"""Limits on effort rates: rows on the coefficients of u', which hold at every instant."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from linkplan.planner.limits.path_limit import (
    RELAXED_FACTOR,
    Bounds,
    Margin,
    PathLimit,
    Problem,
    Samples,
    Scales,
    limited_rows,
    margin_of,
    with_limits,
)
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.bernstein import bernstein_matrix


@dataclass(frozen=True, slots=True)
class EffortRateLimit(PathLimit):
    """The rate of one actuator's effort."""

    key: ClassVar[str] = "effort_rate"
    words: ClassVar[str] = "the effort rate of {}"
    item: int
    tightened: ClassVar[None] = None
    at_nodes: ClassVar[bool] = False

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        return [cls(j) for j in limited_rows(problem.limits.effort_rate)]

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        return tuple(problem.limits.effort_rate[self.item] * scales.time_s / scales.effort[self.item])

    def interval_row(self, unknowns: tuple[int, ...]) -> tuple[str, Any]:
        return "rate_columns", self.item

    def margin(self, samples: Samples) -> Margin:
        actuator = samples.problem.mechanism.actuators[self.item]
        rate, jumps = effort_rates(samples.trajectory, samples.time)
        values = np.where(np.isnan(jumps[:, self.item]), rate[:, self.item], jumps[:, self.item])
        bounds: Sequence[float] = samples.problem.limits.effort_rate[self.item]
        return margin_of(self, actuator.name, values, bounds, f"{actuator.unit}/s", samples)

    @classmethod
    def without(cls, problem: Problem) -> Problem:
        return cls.scaled(problem, RELAXED_FACTOR)

    def narrowed(self, problem: Problem, amount: float) -> Problem:
        rate = np.array(problem.limits.effort_rate)
        rate[self.item] += amount * np.array([1.0, -1.0])
        return with_limits(problem, effort_rate=rate)


def effort_rates(trajectory: Trajectory, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return u' (n, n_u) within intervals, and jumps (n, n_u): an infinite rate with the jump's sign after it, else NaN."""
    degree = trajectory.effort.shape[0] - 1
    widths = np.diff(trajectory.breaks_s)
    index = np.clip(np.searchsorted(trajectory.breaks_s, time, side="right") - 1, 0, len(widths) - 1)
    tau = (time - trajectory.breaks_s[index]) / widths[index]
    slope = degree * np.diff(trajectory.effort, axis=0) / widths[:, None]
    basis = bernstein_matrix(max(degree - 1, 0), tau) if degree else np.zeros((len(time), 0))
    rate = np.einsum("tp,ptu->tu", basis, slope[:, index]) if degree else np.zeros((len(time), trajectory.n_u))
    jumps = np.full((len(time), trajectory.n_u), np.nan)
    step = trajectory.effort[0, 1:] - trajectory.effort[-1, :-1]
    size = 1e-7 * max(float(np.abs(trajectory.effort).max()), np.finfo(float).tiny)
    for k, j in zip(*np.nonzero(np.abs(step) > size), strict=True):
        jumps[np.flatnonzero(index == k + 1)[:1], j] = np.inf * np.sign(step[k, j])
    return rate, jumps
