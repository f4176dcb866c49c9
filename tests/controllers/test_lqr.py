"""Riccati recursions of scalar systems against their limits."""

import numpy as np
import pytest
import scipy.linalg

from linkplan.controllers.trackers.lqr import regulate
from linkplan.models.errors import GainError

# x+ = a x + b u over a cycle of three instants, with costs q x^2 + r u^2; feedback is weak, so that a cycle forgets slowly.
a, b, q, r = np.array([1.02, 0.97, 1.01]), np.array([0.2, 0.1, 0.15]), 0.05, 1.0


def scalar(repeats: bool, along=a, steered=b):
    return regulate(
        along[:, None, None], steered[:, None, None], np.array([[q]]), np.array([[r]]), repeats=repeats
    )  # fmt: skip


def endless(along: np.ndarray, steered: np.ndarray) -> float:
    """Return the cost at the beginning of endless cycles."""
    p = 1.0
    for _ in range(2000):
        for k in (2, 1, 0):
            p = q + along[k] ** 2 * p * r / (r + steered[k] ** 2 * p)
    return p


@pytest.mark.parametrize("steered", [b, 0.2 * b, b * [1, 1, 0]], ids=["strong", "weak", "not at its end"])
def test_costs_of_a_cycle_are_those_of_endless_cycles(steered):
    found, p = scalar(repeats=True, steered=steered), endless(a, steered)
    assert found.cost[0, 0, 0] == pytest.approx(p, rel=1e-12)
    assert found.gains[2, 0, 0] == pytest.approx(a[2] * steered[2] * p / (r + steered[2] ** 2 * p), rel=1e-12)


def test_a_cycle_s_cost_is_not_that_of_rest_at_its_end():
    assert abs(scalar(repeats=False).cost[0, 0, 0] / endless(a, b) - 1) > 1e-3


def test_costs_of_states_that_do_not_touch_each_other_are_their_own():
    weak = 0.55 * b
    A, B = (np.array([np.diag([x, y]) for x, y in zip(*pair, strict=True)]) for pair in ((a, a), (b, weak)))
    found = regulate(A, B, q * np.eye(2), r * np.eye(2), repeats=True)
    assert np.diag(found.cost[0]) == pytest.approx([endless(a, b), endless(a, weak)], rel=1e-12)
    assert found.cost[0, 0, 1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("repeats", [True, False])
def test_costs_of_states_that_touch_each_other_are_symmetric_and_recur(repeats):
    """P_k = Q + A^T P_{k+1} (A - B K) all the way around a cycle, with matrices that do not commute."""
    rng = np.random.default_rng(1)
    A, B = np.eye(3) + 0.2 * rng.standard_normal((4, 3, 3)), rng.standard_normal((4, 3, 2))
    Q, R = np.diag([1.0, 2.0, 3.0]), np.diag([1.0, 0.5])
    found = regulate(A, B, Q, R, repeats=repeats)
    for k, after in enumerate(found.after):
        later = found.cost[after]
        K = np.linalg.solve(R + B[k].T @ later @ B[k], B[k].T @ later @ A[k])
        np.testing.assert_allclose(found.gains[k], K, rtol=1e-9)
        np.testing.assert_allclose(found.cost[k], Q + A[k].T @ later @ (A[k] - B[k] @ K), rtol=1e-9)


def test_a_motion_that_ends_has_the_stationary_cost_at_its_end():
    found = scalar(repeats=False)
    end = scipy.linalg.solve_discrete_are(a[-1:, None], b[-1:, None], [[q]], [[r]])[0, 0]
    assert found.cost[-1, 0, 0] == pytest.approx(end, rel=1e-9)
    for k in (1, 0):
        later = found.cost[k + 1, 0, 0]
        assert found.cost[k, 0, 0] == pytest.approx(q + a[k] ** 2 * later * r / (r + b[k] ** 2 * later), rel=1e-12)


@pytest.mark.parametrize(("repeats", "after"), [(True, [1, 2, 0]), (False, [1, 2, 2])])
def test_the_last_instant_is_followed_by_the_first_of_a_cycle_or_by_itself(repeats, after):
    assert scalar(repeats=repeats).after.tolist() == after


@pytest.mark.parametrize("repeats", [True, False])
def test_what_grows_without_an_effort_that_acts_has_no_gain(repeats):
    with pytest.raises(GainError, match="no stabilising gain"):
        scalar(repeats, steered=0 * b, along=1.1 * np.ones(3))
