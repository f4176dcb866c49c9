"""Efforts of least norm within limits, for more actuators than coordinates."""

import numpy as np
import pytest
import scipy

from linkplan.models.poses.along import effort_within, least_effort


def test_of_two_cables_one_pulls_and_the_other_rests():
    """u_1 - u_2 = tau with 0 <= u <= 3; of 5 the most that there is."""
    maps, limit = np.tile([[[1.0, -1.0]]], (4, 1, 1)), np.array([[0.0, 3.0], [0.0, 3.0]])
    found = effort_within(np.array([[2.0], [-1.5], [0.0], [5.0]]), maps, limit)
    np.testing.assert_allclose(found, [[2.0, 0.0], [0.0, 1.5], [0.0, 0.0], [3.0, 0.0]], atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_efforts_within_limits_miss_by_no_more_than_a_search_does(seed):
    rng = np.random.default_rng(seed)
    tau, maps = rng.normal(size=(10, 2)), rng.normal(size=(10, 2, 4))
    assert np.array_equal(effort_within(tau, maps, np.array([[-np.inf, np.inf]] * 4)), least_effort(tau, maps))
    tight = np.array([[-0.3, 0.5]] * 4)
    found = effort_within(tau, maps, tight)
    assert -0.3 - 1e-9 <= found.min() <= found.max() <= 0.5 + 1e-9
    for u, wanted, B in zip(found, tau, maps, strict=True):
        searched = scipy.optimize.minimize(lambda x, B=B, w=wanted: np.sum((B @ x - w) ** 2), np.zeros(4), bounds=tight)
        assert np.sum((B @ u - wanted) ** 2) <= searched.fun + 1e-9


def test_of_many_weak_drives_each_is_at_its_limit_or_helps_no_more():
    """The gradient g of |B u - tau|^2 is 0 inside the limits, at most 0 at the upper one and at least 0 at the lower."""
    rng = np.random.default_rng(0)
    size = 10 ** rng.uniform(-3, 3, size=(20, 1))  # of the coordinates
    maps, most = size * rng.normal(size=(5, 20, 25)), 10 ** rng.uniform(-3, 1, size=25)
    tau = 10 * rng.normal(size=(5, 20))
    found = effort_within(tau, maps, np.stack([-most, most], axis=1))
    slope = np.einsum("ksu,ks->ku", maps, np.einsum("ksu,ku->ks", maps, found) - tau) / (size.max() * np.abs(tau).max())
    share = found / most
    assert np.sum(np.abs(share) > 1 - 1e-9) > 50  # most drives are too weak
    assert np.abs(share).max() <= 1 + 1e-9
    np.testing.assert_allclose(np.where(np.abs(share) < 1 - 1e-9, slope, np.maximum(0, slope * share)), 0, atol=1e-6)
