"""Limits on pin force as rows that hold at every instant: the square of a closure's force, by Bernstein coefficients.

As with powers, at nodes alone they leave an effort that jumps free to swing beyond them between nodes. The force is an
algebraic unknown, a polynomial through the nodes: what it errs by between them falls with the interval's width.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.planner.problem.planning_problem import PlanningProblem


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceRows:
    """Which closures' forces are limited, and how: `closures` at every instant, of `sizes` rows each; `at_nodes` there."""

    closures: tuple[int, ...] = ()
    sizes: tuple[int, ...] = ()
    at_nodes: tuple[int, ...] = ()

    @property
    def items(self) -> list[tuple[str, int]]:
        """Which limit each row is of, in the order of an interval's own rows."""
        return [("closure_force", c) for c in self.closures]

    @property
    def n_unknowns(self) -> int:
        """The number of algebraic unknowns that they take."""
        return sum(self.sizes)

    def unknowns(self, first: int) -> tuple[tuple[int, ...], ...]:
        """Return the unknowns of each closure's force, numbered from `first` on."""
        ends = np.cumsum([first, *self.sizes]).tolist()
        return tuple(tuple(range(begin, end)) for begin, end in itertools.pairwise(ends))

    def bounds(self) -> np.ndarray:
        """Return the rows' bounds (n, 2): forces are in shares of their ratings, squared."""
        return np.tile([-np.inf, 1.0], (len(self.closures), 1))


def force_rows_of(problem: PlanningProblem, *, everywhere: bool) -> ForceRows:
    """Return how a problem's limits on pin force are imposed: at every instant, or at nodes."""
    limited = problem.limits.limited_closures
    if not everywhere:
        return ForceRows(at_nodes=limited)
    return ForceRows(closures=limited, sizes=tuple(_size(problem.mechanism, c) for c in limited))


def _size(mechanism: Mechanism, closure: int) -> int:
    rows = mechanism.closure_slice(closure)
    return rows.stop - rows.start
