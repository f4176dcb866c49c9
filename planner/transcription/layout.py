"""Indices of a program's unknowns, and sparse matrices as triplets, without scipy.sparse, whose import is slow.

The unknowns stand interval by interval; then come the last state, the durations and the extra unknowns.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Layout:
    """Indices of each interval's unknowns in the vector of all unknowns."""

    n_s: int
    n_z: int
    n_u: int
    n_nodes: int
    n_intervals: int
    n_segments: int
    n_x: int = 0
    n_effort: int = 0  # Bernstein coefficients of each effort; 0 means the number of nodes
    n_extra: int = 0  # unknowns of the whole program after the last state and the durations
    n_open_ends: int = 0  # ends of an interval without a node
    n_z_open_end: int = 0  # algebraic unknowns at each open end

    @property
    def n_state(self) -> int:
        """The number of states at an interval's end."""
        return 2 * self.n_s + self.n_x

    @property
    def effort_coefficients(self) -> int:
        """The number of Bernstein coefficients of an effort on an interval."""
        return self.n_effort or self.n_nodes

    @property
    def block(self) -> int:
        """The number of unknowns of one interval, with its left state."""
        inner = self.n_nodes * (self.n_s + self.n_x + self.n_z) + self.effort_coefficients * self.n_u
        return self.n_state + inner + self.n_open_ends * self.n_z_open_end

    @property
    def size(self) -> int:
        """The number of unknowns."""
        return self.n_intervals * self.block + self.n_state + self.n_segments + self.n_extra

    def state(self, k: int) -> np.ndarray:
        """Return the indices (n_state,) of state k, 0 to n_intervals."""
        return k * self.block + np.arange(self.n_state)

    def states(self) -> np.ndarray:
        """Return indices (n_intervals + 1, n_state): s, v, x."""
        return self.block * np.arange(self.n_intervals + 1)[:, None] + np.arange(self.n_state)

    def acceleration(self) -> np.ndarray:
        """Return indices (n_intervals, n_nodes, n_s)."""
        return self._inner(self.n_state, self.n_nodes, self.n_s)

    def rate(self) -> np.ndarray:
        """Return indices (n_intervals, n_nodes, n_x) of the first-order states' rates."""
        return self._inner(self.n_state + self.n_nodes * self.n_s, self.n_nodes, self.n_x)

    def dependent(self) -> np.ndarray:
        """Return indices (n_intervals, n_nodes, n_z)."""
        return self._inner(self.n_state + self.n_nodes * (self.n_s + self.n_x), self.n_nodes, self.n_z)

    def effort(self) -> np.ndarray:
        """Return indices (n_intervals, n_coefficients, n_u) of Bernstein coefficients."""
        start = self.n_state + self.n_nodes * (self.n_s + self.n_x + self.n_z)
        return self._inner(start, self.effort_coefficients, self.n_u)

    def open_end_dependent(self) -> np.ndarray:
        """Return indices (n_intervals, n_open_ends, n_z_open_end) of algebraic unknowns at open ends."""
        return self._inner(self.block - self.n_open_ends * self.n_z_open_end, self.n_open_ends, self.n_z_open_end)

    def durations(self) -> np.ndarray:
        """Return the indices (n_segments,) of the segments' durations."""
        return self.size - self.n_extra - self.n_segments + np.arange(self.n_segments)

    def extra(self) -> np.ndarray:
        """Return the indices (n_extra,) of the extra unknowns."""
        return self.size - self.n_extra + np.arange(self.n_extra)

    def _inner(self, start: int, count: int, width: int) -> np.ndarray:
        inner = np.arange(count * width).reshape(count, width)
        return start + self.block * np.arange(self.n_intervals)[:, None, None] + inner


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Triplets:
    """A sparse matrix by its nonzeros: rows, columns and values (n,), at distinct places."""

    rows: np.ndarray
    columns: np.ndarray
    values: np.ndarray
    shape: tuple[int, int]

    def dm(self) -> ca.DM:
        """Return the CasADi matrix."""
        order = np.lexsort((self.rows, self.columns))
        return ca.DM(pattern(self.rows[order], self.columns[order], self.shape), self.values[order])


def no_rows(size: int) -> Triplets:
    """Return the matrix (0, size)."""
    none = np.zeros(0, dtype=int)
    return Triplets(rows=none, columns=none, values=np.zeros(0), shape=(0, size))


def pattern(rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]) -> ca.Sparsity:
    """Return the sparsity pattern of nonzeros sorted by column, then by row."""
    begins = np.searchsorted(columns, np.arange(shape[1] + 1))
    return ca.Sparsity(shape[0], shape[1], begins.tolist(), rows.tolist())


def scatter(target: np.ndarray, size: int) -> ca.DM:
    """Return the matrix (size, n) that adds value i to entry target[i]."""
    n = len(target)
    return ca.DM(ca.Sparsity(size, n, list(range(n + 1)), np.asarray(target).tolist()), np.ones(n))
