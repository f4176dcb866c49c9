"""Small linear systems over balls and series: solutions against numpy, and systems that may be singular."""

import numpy as np
import pytest
from flint import arb, arb_series

from linkplan.planner.proof.taylor import NotSeparatedError, product, solve_enclosed, transposed


def entries(A: np.ndarray) -> dict:
    return {(i, j): arb(float(A[i, j])) for i, j in np.argwhere(A)}


def numbers(x) -> np.ndarray:
    return np.array([float(one.mid()) for one in x])


@pytest.mark.parametrize("seed", range(4))
def test_sparse_systems_have_the_solutions_of_dense_ones(seed):
    """With zeros on the diagonal, so that rows change places, and right sides with zeros, which None stands for."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(5, 5)) * (rng.uniform(size=(5, 5)) < 0.6)
    np.fill_diagonal(A[:, ::-1], rng.choice([-1, 1], 5) * rng.uniform(1.0, 2.0, 5))
    b = rng.normal(size=(5, 2)) * (rng.uniform(size=(5, 2)) < 0.6)
    found = solve_enclosed(entries(A), [[arb(float(x)) if x else None for x in column] for column in b.T])
    np.testing.assert_allclose(np.array([numbers(x) for x in found]).T, np.linalg.solve(A, b), atol=1e-12)
    (flat,) = solve_enclosed(transposed(entries(A)), [[arb(float(x)) for x in b[:, 0]]])
    np.testing.assert_allclose(numbers(flat), np.linalg.solve(A.T, b[:, 0]), atol=1e-12)
    np.testing.assert_allclose(numbers(product(entries(A), [arb(float(x)) for x in b[:, 1]], 5)), A @ b[:, 1], atol=1e-12)


def test_a_system_of_series_is_solved_coefficient_by_coefficient():
    """(2 + t) x = 1 + 3 t."""
    ((x,),) = solve_enclosed({(0, 0): arb_series([2, 1], prec=3)}, [[arb_series([1, 3], prec=3)]])
    assert [float(x[k].mid()) for k in range(3)] == pytest.approx([0.5, 1.25, -0.625])


@pytest.mark.parametrize("matrix", [{(0, 0): arb(0, 1)}, {(0, 0): arb(1, 1)}, {(0, 0): arb(-1, 1.5)}, {}])
def test_a_pivot_that_may_vanish_is_refused(matrix):
    with pytest.raises(NotSeparatedError):
        solve_enclosed(matrix, [[arb(1)]])
    assert solve_enclosed({(0, 0): arb(-1, 0.5)}, [[arb(1)]])
