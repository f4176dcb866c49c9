"""Limits on power as rows that hold at every instant: products of Bernstein coefficients of an effort and of its speed.

At nodes alone a limit on u w leaves an effort that jumps free to swing beyond it between them, on however fine a mesh.
"""

from dataclasses import dataclass

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.planner.closed_chain.mechanics import Scales
from linkplan.planner.problem.planning_problem import PlanningProblem


@dataclass(frozen=True, slots=True, kw_only=True)
class PowerRows:
    """Which actuators' powers are limited, and how.

    `columns` are pairs (actuator, independent column) of those that drive a coordinate itself: their speed is a polynomial
    of the program; `geared` are others, whose speed is the sum of `levers` (actuator, independent column), each an algebraic
    unknown, times the columns' speeds; `at_nodes` are those that nodes limit.
    """

    columns: tuple[tuple[int, int], ...] = ()
    geared: tuple[int, ...] = ()
    levers: tuple[tuple[int, int], ...] = ()
    at_nodes: tuple[int, ...] = ()

    @property
    def items(self) -> list[tuple[str, int]]:
        """Which limit each row is of, in the order of an interval's own rows."""
        return [("power", j) for j in (*(j for j, _ in self.columns), *self.geared)]

    def of_levers(self, first: int) -> tuple[tuple[int, tuple[tuple[int, int], ...]], ...]:
        """Return (actuator, ((unknown, column), ...)) of those geared, their levers' unknowns numbered from `first` on."""
        numbered = [(first + k, j, column) for k, (j, column) in enumerate(self.levers)]
        return tuple((j, tuple((k, column) for k, of, column in numbered if of == j)) for j in self.geared)

    def bounds(self, problem: PlanningProblem, scales: Scales) -> np.ndarray:
        """Return the rows' bounds (n, 2), scaled."""
        limit, units = problem.limits.power, []
        for j, column in self.columns:
            gear = problem.mechanism.actuators[j].gear
            units.append(gear * scales.effort[j] * scales.position[column] / scales.time_s)
        units += [scales.power] * len(self.geared)
        found = [limit[j] / unit for (_, j), unit in zip(self.items, units, strict=True)]
        return np.sort(np.array(found).reshape(-1, 2), axis=1)  # a gear below zero turns the ends round


def power_rows_of(problem: PlanningProblem, *, everywhere: bool) -> PowerRows:
    """Return how a problem's limits on power are imposed: at every instant, or at nodes."""
    limited = tuple(int(j) for j in np.flatnonzero(np.isfinite(problem.limits.power).any(axis=1)))
    if not everywhere:
        return PowerRows(at_nodes=limited)
    own = {j: own_column(problem.mechanism, j) for j in limited}
    columns = tuple((j, column) for j, column in own.items() if column is not None)
    acts = problem.mechanism.dynamics.effort_map.sparsity_out(0)
    others = [j for j, column in own.items() if column is None]
    levers = tuple((j, s) for j in others for s in range(problem.mechanism.dof) if acts.has_nz(s, j))
    geared = tuple(dict.fromkeys(j for j, _ in levers))  # what has no lever on anything has no power
    return PowerRows(columns=columns, geared=geared, levers=levers)


def own_column(mechanism: Mechanism, j: int) -> int | None:
    """Return the independent column that an actuator drives directly, or None."""
    joint = mechanism.actuators[j].joint
    places = np.flatnonzero(mechanism.independent == joint) if joint is not None else []
    return int(places[0]) if len(places) else None
