"""Efforts distributed among more actuators than freedoms, within their limits, against a search by scipy."""

import numpy as np
import pytest
import scipy

from linkplan.models.actuation.distribution import LEAST_PEAK, distribute

SEEDS = range(12)


def drawn(seed: int) -> tuple[np.ndarray, ...]:
    """Return moment arms (n_s, n_u), limits (n_u, 2), efforts (n_u,) within them, and efforts (n_u,) wanted."""
    rng = np.random.default_rng(seed)
    n_s = int(rng.integers(1, 4))
    n_u = n_s + int(rng.integers(1, 4))
    arms = rng.normal(size=(n_s, n_u)) * 10 ** rng.uniform(-2, 2)
    limit = np.sort(rng.normal(size=(n_u, 2)), axis=1) * 10 ** rng.uniform(-1, 2)
    return arms, limit, rng.uniform(limit[:, 0], limit[:, 1]), rng.normal(size=n_u) * (seed % 2)


@pytest.mark.parametrize("seed", SEEDS)
def test_efforts_within_limits_are_the_nearest_to_those_wanted(seed):
    arms, limit, inside, wanted = drawn(seed)
    tau = arms @ inside
    (found,) = distribute(tau[None], arms[None], limit, wanted)
    np.testing.assert_allclose(arms @ found, tau, atol=1e-9 * np.abs(arms).max() * np.abs(limit).max())
    assert np.all((found >= limit[:, 0]) & (found <= limit[:, 1]))
    produced = {"type": "eq", "fun": lambda u: (arms @ u - tau) / np.abs(arms).max()}
    searched = scipy.optimize.minimize(
        lambda u: np.sum((u - wanted) ** 2), inside, bounds=limit, constraints=[produced], options={"ftol": 1e-14}
    )
    assert np.sum((found - wanted) ** 2) <= searched.fun * (1 + 1e-6) + 1e-9


@pytest.mark.parametrize("seed", SEEDS)
def test_efforts_beyond_the_limits_violate_them_least(seed):
    arms, limit, inside, _ = drawn(seed)
    size = np.abs(limit).max(axis=1)
    tau = 20 * arms @ (inside + size)
    (found,) = distribute(tau[None], arms[None], limit)
    np.testing.assert_allclose(arms @ found, tau, rtol=1e-9, atol=1e-9 * np.abs(tau).max())

    def violation(u: np.ndarray) -> float:
        return float(np.sum(((u - np.clip(u, *limit.T)) / size) ** 2))

    assert violation(found) > 1e-6  # the effect is present
    null = scipy.linalg.null_space(arms)
    searched = scipy.optimize.minimize(lambda z: violation(found + size.max() * null @ z), np.zeros(null.shape[1]))
    assert violation(found) <= searched.fun * (1 + 1e-5) + 1e-9


@pytest.mark.parametrize("seed", SEEDS)
def test_the_least_peak_is_that_of_a_linear_program(seed):
    arms, limit, inside, _ = drawn(seed)
    tau, size = arms @ inside, np.abs(limit).max(axis=1)
    (found,) = distribute(tau[None], arms[None], limit, rule=LEAST_PEAK)
    n_u = len(limit)
    peak = np.hstack([np.vstack([np.eye(n_u), -np.eye(n_u)]) / np.tile(size, 2)[:, None], -np.ones((2 * n_u, 1))])
    best = scipy.optimize.linprog(
        np.append(np.zeros(n_u), 1.0), peak, np.zeros(2 * n_u), np.hstack([arms, np.zeros((len(arms), 1))]), tau,
        [*map(tuple, limit), (0, None)],
    )  # fmt: skip
    assert np.all((found >= limit[:, 0]) & (found <= limit[:, 1]))
    assert np.abs(found / size).max() == pytest.approx(best.fun, rel=1e-4, abs=1e-6)


def test_samples_together_have_the_efforts_of_each_alone():
    rng = np.random.default_rng(3)
    maps, limit = rng.normal(size=(60, 3, 5)), np.tile([[5.0, 200.0]], (5, 1))
    tau = np.einsum("ksu,ku->ks", maps, rng.uniform(5, 200, (60, 5)))
    together = distribute(tau, maps, limit)
    alone = [distribute(tau[k : k + 1], maps[k : k + 1], limit)[0] for k in range(60)]
    np.testing.assert_allclose(together, alone, rtol=1e-12)
    assert np.sum(together == 5.0) > 20  # cables at their least tension


def test_of_two_cables_one_pulls_and_the_other_rests():
    """u_1 - u_2 = tau with 0 <= u <= 3; 5 is 2 more than there is."""
    maps, limit = np.tile([[[1.0, -1.0]]], (4, 1, 1)), np.array([[0.0, 3.0], [0.0, 3.0]])
    found = distribute(np.array([[2.0], [-1.5], [0.0], [5.0]]), maps, limit)
    np.testing.assert_allclose(found, [[2.0, 0.0], [0.0, 1.5], [0.0, 0.0], [4.0, -1.0]], atol=1e-7)


def test_one_actuator_gives_what_is_needed_whatever_its_limits():
    assert distribute(np.array([[6.0]]), np.array([[[2.0]]]), np.array([[-1.0, 1.0]])).item() == 3.0


def test_at_a_dead_centre_an_actuator_keeps_the_effort_wanted():
    found = distribute(np.array([[0.0, 1.0]]), np.array([[[0.0, 0.0], [0.0, 1.0]]]), np.array([[-9.0, 9.0]] * 2), [2.0, 5.0])
    np.testing.assert_allclose(found, [[2.0, 1.0]])


@pytest.mark.parametrize("unit", [1.0, 1e5])
def test_the_least_violation_and_the_least_peak_do_not_depend_on_the_size_of_the_limits(unit):
    maps, limit = np.array([[[0.02, -0.0015]]]), unit * np.array([[5.0, 150.0]] * 2)
    best = unit * np.array([5.0, 150.0])  # nearest to the effort -0.2226 that no efforts within the limits give
    slope = maps[0, 0] * 150.0 * unit
    violation = slope * (-0.2226 * unit - maps[0, 0] @ best) / (slope @ slope)
    (found,) = distribute(np.array([[-0.2226 * unit]]), maps, limit)
    assert found == pytest.approx(best + 150.0 * unit * violation, rel=1e-6)
    (found,) = distribute(
        np.array([[3.0 * unit]]), np.ones((1, 1, 2)), unit * np.array([[-4.0, 4.0], [-2.0, 2.0]]), rule=LEAST_PEAK
    )
    assert found == pytest.approx([2.0 * unit, unit], rel=1e-6)
