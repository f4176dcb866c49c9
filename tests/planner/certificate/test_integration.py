"""Integration with restarts along a rod that stands upright, on which errors grow as in closed form."""

import numpy as np
import pytest
from scipy.linalg import expm

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.certificate.integration import RESTART_GROWTH, _linear_growth, integrate
from linkplan.planner.problem.instant import position_units
from linkplan.planner.trajectory import Trajectory
from tests.support.bodies import PENDULUM
from tests.support.motions import motion_along

# About upright I e'' = m g l e: errors grow by e^(RATE t).
WEIGHT, INERTIA = 9.81 * 0.5, 0.26
RATE = np.sqrt(WEIGHT / INERTIA)
SPEED, WIDTH_S = 2.0, 0.2
ALLOWED = np.array([np.radians(0.01)])


def standing(angle: float, n: int, effort: float = 0.0) -> Trajectory:
    return motion_along(WIDTH_S * np.arange(n + 1), np.full((2, n, 1), angle), effort=effort)


def rod():
    return load_mechanism(PENDULUM.format(limit=20))


def growths(n: int, stiffness: float = WEIGHT / INERTIA, size=lambda matrix: np.abs(matrix).max()) -> np.ndarray:
    """Return the largest entry of the transition matrix, in units of position and speed, after each interval."""
    unit = np.array([float(position_units(rod(), standing(np.pi, n).position)[0]), SPEED])
    step = expm(WIDTH_S * np.array([[0.0, 1.0], [stiffness, 0.0]]) * unit / unit[:, None])
    return np.array([size(np.linalg.matrix_power(step, k)) for k in range(1, n + 1)])


def until_restart(n: int) -> int:
    """Return the number of intervals in which an error may grow by `RESTART_GROWTH`, in the spectral norm."""
    return int(np.flatnonzero(growths(n, size=lambda matrix: np.linalg.norm(matrix, 2)) > RESTART_GROWTH)[0]) + 1


def test_an_integration_is_begun_anew_whenever_an_error_would_have_grown_ten_thousandfold():
    n = 40
    before = until_restart(n)
    found = integrate(rod(), standing(np.pi, n), SPEED, ALLOWED)
    assert found.restarts == n // before >= 3
    assert found.position[0] < 1e-9
    assert found.growth.shape == (n,)


@pytest.mark.parametrize("effort", [1e-8, -1e-7])
def test_an_effort_that_is_not_the_motion_s_leads_away_up_to_each_restart(effort):
    """From rest at upright a torque u leads to u / (m g l) (cosh(RATE t) - 1)."""
    n = 40
    before = until_restart(n)
    away = abs(effort) / WEIGHT * (np.cosh(RATE * WIDTH_S * before) - 1)
    fast = abs(effort) / WEIGHT * RATE * np.sinh(RATE * WIDTH_S * before)
    found = integrate(rod(), standing(np.pi, n, effort), SPEED, ALLOWED)
    assert found.restarts == n // before
    assert found.position[0] == pytest.approx(away, rel=1e-4)
    assert found.velocity == pytest.approx(fast / SPEED, rel=1e-4)
    # Each interval adds the same, and all of them what is off in the end.
    np.testing.assert_allclose(found.growth, found.growth[0], rtol=1e-4)
    assert found.growth.sum() == pytest.approx(away / ALLOWED[0], rel=1e-4)


@pytest.mark.parametrize(("angle", "stiffness"), [(np.pi, WEIGHT / INERTIA), (0.0, -WEIGHT / INERTIA)])
def test_the_linear_growth_is_that_of_the_transition_matrix(angle, stiffness):
    n, mechanism = 8, rod()
    motion = standing(angle, n)
    unit = np.array([float(position_units(mechanism, motion.position)[0]), SPEED])
    found = _linear_growth(mechanism, motion, np.full((n, 1), angle), unit)
    assert found == pytest.approx(max(1.0, growths(n, stiffness).max()), rel=1e-3)


def test_the_growth_of_minutes_at_upright_does_not_overflow():
    """A plan of 80 s printed numpy's "overflow encountered in matmul"."""
    n = round(1000 / (RATE * WIDTH_S))  # e^1000 is beyond the largest float
    motion = standing(np.pi, n)
    with np.errstate(over="raise", invalid="raise"):
        assert _linear_growth(rod(), motion, np.full((n, 1), np.pi), np.ones(2)) > RESTART_GROWTH


def test_a_stable_motion_with_other_efforts_is_off_by_the_closed_form_and_not_begun_anew():
    """At rest, after a turn, a torque u makes a pendulum swing to u / (m g l) (1 - cos(RATE t))."""
    n, effort = 12, 1e-2
    found = integrate(rod(), standing(2 * np.pi, n, effort), SPEED, ALLOWED)
    times = WIDTH_S * np.arange(0.0, n + 0.5, 0.5)
    away = effort / WEIGHT * (1 - np.cos(RATE * times))
    assert found.restarts == 0
    assert found.position[0] == pytest.approx(away.max(), rel=1e-3)
    assert found.velocity == pytest.approx(np.abs(effort / WEIGHT * RATE * np.sin(RATE * times)).max() / SPEED, rel=1e-3)
    largest = np.maximum(away[1::2], np.maximum(away[:-1:2], away[2::2]))
    np.testing.assert_allclose(found.growth, np.abs(np.diff(np.append(0.0, largest))) / ALLOWED[0], rtol=1e-2, atol=1e-2)
