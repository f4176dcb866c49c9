"""Riccati recursions of scalar systems against their limits."""

import numpy as np
import pytest

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


@pytest.mark.parametrize("repeats", [True, False])
def test_what_grows_without_an_effort_that_acts_has_no_gain(repeats):
    with pytest.raises(GainError, match="no stabilising gain"):
        scalar(repeats, steered=0 * b, along=1.1 * np.ones(3))
