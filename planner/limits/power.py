"""Limits on mechanical power: rows at nodes, or at every instant by products of Bernstein coefficients of effort and speed.

At nodes alone, a limit on u w lets an effort that jumps exceed it between nodes, even on fine meshes.
"""

from dataclasses import dataclass
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.models.poses.along import sampled
from linkplan.planner.limits.joints import own_column
from linkplan.planner.limits.path_limit import (
    Bounds,
    Instant,
    Margin,
    MotionArrays,
    PathLimit,
    Problem,
    Samples,
    Scales,
    limited_rows,
    margin_of,
)


@dataclass(frozen=True, slots=True)
class PowerLimit(PathLimit):
    """The power of one actuator, limited at nodes or at every instant.

    The speed of an actuator that drives a coordinate directly is that of the `column`, a polynomial of the program. The
    speed of any other is the sum of `levers`, each an algebraic unknown, times the columns' speeds.
    """

    key: ClassVar[str] = "power"
    words: ClassVar[str] = "the power of {}"
    enclosable: ClassVar[bool] = True
    jumps_with_effort: ClassVar[bool] = True
    item: int
    column: int | None = None
    levers: tuple[int, ...] = ()

    @classmethod
    def of(cls, problem: Problem, *, enclosed: bool = False, **_: bool) -> list[Self]:
        limited = limited_rows(problem.limits.power)
        if not enclosed:
            return [cls(j) for j in limited]
        own = {j: own_column(problem.mechanism, j) for j in limited}
        acts = problem.mechanism.dynamics.effort_map.sparsity_out(0)
        levers = {j: tuple(s for s in range(problem.mechanism.dof) if acts.has_nz(s, j)) for j in limited}
        columns = [cls(j, column) for j, column in own.items() if column is not None]
        return columns + [cls(j, None, levers[j]) for j, column in own.items() if column is None and levers[j]]

    @property
    def at_nodes(self) -> bool:
        return self.column is None and not self.levers

    def row(self, at: Instant, numbers: ca.SX) -> ca.SX:
        return at.u[self.item] * at.actuator_speeds[self.item] / at.units["power"]

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        unit = scales.power
        if self.column is not None:
            gear = problem.mechanism.actuators[self.item].gear
            unit = gear * scales.effort[self.item] * scales.position[self.column] / scales.time_s
        return tuple(np.sort(problem.limits.power[self.item] / unit))  # a negative gear exchanges the bounds

    def interval_row(self, unknowns: tuple[int, ...]) -> tuple[str, Any] | None:
        if self.column is not None:
            return "power_columns", (self.item, self.column)
        return ("power_levers", (self.item, tuple(zip(unknowns, self.levers, strict=True)))) if self.levers else None

    @property
    def n_unknowns(self) -> int:
        return len(self.levers)

    def unknowns(self, at: Instant, numbers: ca.SX) -> tuple[str, list[ca.SX]]:
        rate = at.units["position"] / at.units["time"]
        leverage = ca.diag(rate) @ at.of_pose("effort_map") @ ca.diag(at.units["effort"]) / at.units["power"]
        return "leverage", [leverage[s, self.item] for s in self.levers]

    def start_of_unknowns(self, problem: Problem, scales: Scales, motion: MotionArrays) -> np.ndarray:
        maps = sampled(problem.mechanism.dynamics.effort_map, motion[0])
        rate, columns = scales.position / scales.time_s, list(self.levers)
        return maps[:, columns, self.item] * scales.effort[self.item] * rate[columns] / scales.power

    def margin(self, samples: Samples) -> Margin:
        j, problem = self.item, samples.problem
        values = samples.u[:, j] * samples.actuator_speeds[:, j]
        return margin_of(self, problem.mechanism.actuators[j].name, values, problem.limits.power[j], "W", samples)
