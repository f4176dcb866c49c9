"""The certificate's integrations: explicit steps, restarts along unstable motions, an implicit method for stiff ones."""

import warnings

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import DOP853, solve_ivp
from scipy.linalg import expm

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.certificate import dormand_prince, integration
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.certificate.flow import _share_of_error, side_by_side, strides
from linkplan.planner.certificate.integration import RESTART_GROWTH, _linear_growth, integrate
from linkplan.planner.problem.instant import position_units
from linkplan.planner.trajectory import Trajectory
from tests.support.bodies import PENDULUM, QUARTER_TURN, TURN, body_problem
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


def pendulum():
    x, u, tau = ca.SX.sym("x", 2), ca.SX.sym("u", 2), ca.SX.sym("tau")
    return ca.Function("rate", [x, u, tau], [ca.vertcat(x[1], -9.81 * ca.sin(x[0]) + u[0] + u[1] * tau)])


def test_the_coefficients_are_scipys():
    for i, row in enumerate(dormand_prince.A):
        np.testing.assert_array_equal(row, DOP853.A[i, :i])
    for name in ("B", "C", "E5", "E3"):
        np.testing.assert_array_equal(getattr(dormand_prince, name), getattr(DOP853, name))


def adaptive(h: float, a: float, b: float, state: np.ndarray, times) -> np.ndarray:
    """Return the states (n, 2) of a pendulum whose input goes from a to a + b in h seconds."""
    right = lambda t, x: [x[1], -9.81 * np.sin(x[0]) + a + b * t / h]  # noqa: E731
    return solve_ivp(right, (0, h), state, method="DOP853", rtol=1e-13, atol=1e-14, t_eval=times).y.T


def test_states_are_those_of_adaptive_steps():
    widths, inputs = np.array([0.05, 0.08, 0.03, 0.05, 0.06, 0.04]), np.random.default_rng(0).normal(0, 5, (6, 2))
    reached, state = strides(pendulum(), widths, inputs, np.array([1.0, 0.5])), np.array([1.0, 0.5])
    assert len(reached) == len(widths)
    for k, (h, (a, b)) in enumerate(zip(widths, inputs, strict=True)):
        exact = adaptive(h, a, b, state, [h / 2, h])
        np.testing.assert_allclose(reached[k], exact, rtol=0, atol=2e-12)
        state = exact[-1]


def test_steps_are_as_short_as_the_error_requires_and_long_again_after():
    """A weight passes the middle of its spring, which is much stiffer within a hundredth of a radian there."""
    x, u, tau = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("tau")
    rate = ca.Function("rate", [x, u, tau], [ca.vertcat(x[1], -9.81 * x[0] - 4.0 * x[0] / (1e-4 + x[0] ** 2) + 0 * u * tau)])
    widths, shares, begin = np.array([0.05, 1.2, 0.05]), np.array([0.3, 1.0]), np.array([1.0, 0.0])
    reached = strides(rate, widths, np.zeros((3, 1)), begin, shares)
    times = (np.cumsum(widths) - widths)[:, None] + widths[:, None] * shares
    right = lambda _, y: np.array(rate(y, 0, 0)).ravel()  # noqa: E731
    exact = solve_ivp(right, (0, 1.3), begin, method="DOP853", rtol=1e-13, atol=1e-14, t_eval=times.ravel())
    np.testing.assert_allclose(reached.reshape(-1, 2), exact.y.T, rtol=0, atol=1e-9)


def test_an_interval_on_which_a_state_becomes_infinite_ends_what_is_returned():
    x, u, tau = ca.SX.sym("x"), ca.SX.sym("u"), ca.SX.sym("tau")
    rate = ca.Function("rate", [x, u, tau], [x**2 + 0 * u * tau])  # from 1, infinite at 1 s
    reached = strides(rate, np.full(4, 0.3), np.zeros((4, 1)), np.ones(1))
    np.testing.assert_allclose(
        reached[:, :, 0], 1.0 / (1.0 - 0.3 * np.array([[0.5, 1.0], [1.5, 2.0], [2.5, 3.0]])), rtol=1e-10
    )


def test_a_rate_that_is_not_a_number_ends_it_too():
    x, u, tau = ca.SX.sym("x"), ca.SX.sym("u"), ca.SX.sym("tau")
    rate = ca.Function("rate", [x, u, tau], [ca.sqrt(1.0 - x + 0 * u * tau)])
    assert len(strides(rate, np.full(20, 0.2), np.zeros((20, 1)), np.array([2.0]))) == 0


def test_a_step_to_infinity_is_too_long_without_a_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        errors = np.array([[np.inf, 0.0], [np.inf, 0.0]])
        share = _share_of_error(np.array([[1.0, 1.0]]), np.array([[np.inf, 1.0]]), errors, 1e-11)
    assert share.tolist() == [np.inf, 0.0]


def test_intervals_side_by_side_go_each_from_its_own_state_where_even_steps_do_and_where_they_are_too_long():
    widths, inputs = np.array([0.05, 3.0, 0.04]), np.random.default_rng(1).normal(0, 5, (3, 2))
    states, shares = np.array([[1.0, 0.5], [2.0, 0.0], [-1.0, 3.0]]), np.array([0.1, 0.5, 0.8, 1.0])
    reached = side_by_side(pendulum(), widths, inputs, states, shares)
    for k, (h, (a, b)) in enumerate(zip(widths, inputs, strict=True)):
        np.testing.assert_allclose(reached[k], adaptive(h, a, b, states[k], shares * h), rtol=0, atol=2e-10)


def test_intervals_side_by_side_are_none_where_one_fails():
    x, u, tau = ca.SX.sym("x"), ca.SX.sym("u"), ca.SX.sym("tau")
    rate = ca.Function("rate", [x, u, tau], [x**2 + 0 * u * tau])  # x = 1 / (1 / x_0 - t)
    shares, begins = np.array([0.5, 1.0]), np.array([[0.1], [0.5]])
    assert side_by_side(rate, np.full(2, 1.0), np.zeros((2, 1)), begins, shares) is not None
    assert side_by_side(rate, np.full(2, 3.0), np.zeros((2, 1)), begins, shares) is None


@pytest.mark.parametrize(
    ("fifth", "third", "share"), [(2.0, 2.0, 1.9901), (0.9, 0.0, 0.9), (0.5, 5.0, 0.35355), (1.1, 1.1, 1.0946)]
)
def test_the_error_of_a_step_weighs_its_estimates_as_hairer_norsett_and_wanner_do(fifth, third, share):
    """err = err5^2 / sqrt((err5^2 + err3^2 / 100) n), with both in units of the tolerance (II.10, after (10.17))."""
    state = np.zeros((1, 1))
    tolerance = 1e-13
    found = _share_of_error(state, state, tolerance * np.array([[fifth], [third]]), 1e-12)
    assert found.tolist() == pytest.approx([share], rel=1e-4)


@pytest.mark.parametrize(("before", "after", "allowed"), [(0.2, 0.1, 0.3), (3.0, -5.0, 5.3), (-5.0, 3.0, 5.5)])
def test_the_error_allowed_in_a_step_is_that_of_the_larger_end_and_a_tenth_of_the_first(before, after, allowed):
    """Of the tolerance; a tenth of one at least, for states that pass through zero."""
    errors = 1e-12 * np.array([[0.7 * allowed], [0.0]])
    assert _share_of_error(np.array([[before]]), np.array([[after]]), errors, 1e-12).tolist() == pytest.approx([0.7])


# Inertia over damping is 10 us. The motion takes 1.5 s.
FINGER_INERTIA, DAMPING, DURATION_S = 1e-5, 1.0, 1.5
DAMPED = f"""<mujoco><option gravity="0 0 0"/><worldbody>
<body name="finger"><joint name="J" axis="0 1 0" damping="{DAMPING}"/>
<inertial pos="0 0 0" mass="0.01" diaginertia="{FINGER_INERTIA} {FINGER_INERTIA} {FINGER_INERTIA}"/></body></worldbody>
<actuator><motor name="motor" joint="J" ctrlrange="-4 4"/></actuator></mujoco>"""


def cubic_turn(n: int = 10) -> Trajectory:
    """Return the quarter turn by a cubic from rest to rest in n intervals, with the efforts that it needs."""
    t = np.linspace(0.0, 1.0, n + 1)
    s, v = np.radians(10.0) + TURN * t**2 * (3 - 2 * t), 6 * TURN * t * (1 - t) / DURATION_S
    a, jerk, h = 6 * TURN * (1 - 2 * t) / DURATION_S**2, -12 * TURN / DURATION_S**3, DURATION_S / n
    u, rate = FINGER_INERTIA * a + DAMPING * v, FINGER_INERTIA * jerk + DAMPING * a
    position = [s[:-1], s[:-1] + h * v[:-1] / 3, s[1:] - h * v[1:] / 3, s[1:]]
    return motion_along(DURATION_S * t, position, effort=[u[:-1], u[:-1] + h * rate[:-1] / 2, u[1:]])


def test_a_stiff_motion_is_integrated_by_an_implicit_method(monkeypatch):
    counts, called = [], integration.called

    def counting(*given):
        rate = called(*given)
        counts.append(0)

        def counted(t, y):
            counts[-1] += 1
            return rate(t, y)

        return counted

    monkeypatch.setattr(integration, "called", counting)
    certificate = certify(body_problem(DAMPED, QUARTER_TURN + f"duration_s = {DURATION_S}\n"), cubic_turn())
    assert certificate.passed, certificate.failures
    # Explicit steps take up to 27,000 evaluations on an interval.
    assert len(counts) == len(cubic_turn().breaks_s) - 1
    assert max(counts) < 200
