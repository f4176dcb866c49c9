"""The linear systems of the nearest feasible point: the same step with stretched columns, from sparse factors."""

import casadi as ca
import numpy as np
import pytest
import scipy.sparse

from linkplan.planner.solvers import newton


def chain(n: int) -> scipy.sparse.csc_matrix:
    """Return rows (n, n + 2) of a chain of unknowns and of two durations, which are in each row, as a long mesh has them."""
    rng = np.random.default_rng(3)
    band = scipy.sparse.diags([np.full(n, 2.0), rng.uniform(0.3, 0.9, n - 1)], [0, -1])
    return scipy.sparse.csc_matrix(scipy.sparse.hstack([band, rng.normal(size=(n, 2))]))


def step_of(rows: scipy.sparse.csc_matrix, weight: np.ndarray, missing: np.ndarray) -> np.ndarray | None:
    free, binding = np.zeros(rows.shape[1], dtype=bool), np.ones(rows.shape[0], dtype=bool)
    return newton._least_step(ca.DM(rows), missing, weight, free, binding)


@pytest.mark.parametrize("n", [30, 49, 50, 51, 500])
def test_the_step_is_the_one_of_least_weighted_norm(n):
    rows, rng = chain(n), np.random.default_rng(4)
    weight, missing = rng.uniform(0.5, 2.0, n + 2), rng.normal(size=n)
    dense = rows.toarray()
    normal = (dense / weight) @ dense.T
    expected = (dense / weight).T @ np.linalg.solve(normal, missing)
    step = step_of(rows, weight, missing)
    assert step is not None
    np.testing.assert_allclose(step, expected, atol=1e-9 * np.abs(expected).max())


def test_durations_in_every_row_do_not_fill_the_factors(monkeypatch):
    n, filled = 5000, []
    factors = scipy.sparse.linalg.splu

    def counted(matrix):
        found = factors(matrix)
        filled.append((found.L.nnz + found.U.nnz) / matrix.nnz)
        return found

    monkeypatch.setattr(scipy.sparse.linalg, "splu", counted)
    assert step_of(chain(n), np.ones(n + 2), np.ones(n)) is not None
    assert filled[0] < 20
