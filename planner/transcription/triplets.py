"""Sparse matrices as triplets and as CasADi matrices, without scipy.sparse, whose import is slow."""

from dataclasses import dataclass

import casadi as ca
import numpy as np


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
