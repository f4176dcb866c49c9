"""Optimal-control problems with closed forms that stress a problem's less usual parts: time, ends, free states, returns."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad_vec, solve_ivp
from scipy.linalg import expm

from tests.support.ode import (
    FREE_EFFORT,
    INF,
    NAN,
    OSCILLATOR,
    double_integrator,
    duration,
    oscillator,
    solved,
    squared_effort,
)
from tests.support.tolerances_planner import ODE_BOUND_BY_A_STATE, ODE_CLOSED_FORM, ODE_GAIN, ODE_LIMIT, ODE_STATE

# Time in the dynamics, the cost and the path.


def test_a_lever_that_grows_with_time_is_pushed_in_proportion_to_it():
    plan = solved(
        rate=lambda x, u, p, t: [t * u[0]],  # noqa: ARG005
        start=[0],
        goal=[2],
        effort_limit=FREE_EFFORT,
        duration_s=1.5,
        running_cost=squared_effort,
    )
    slope = 3 * 2 / 1.5**3
    assert plan.objective == pytest.approx(2 * slope, rel=ODE_CLOSED_FORM)
    time = plan.trajectory.dense_times()
    np.testing.assert_allclose(plan.trajectory.effort_at(time)[:, 0], slope * time, atol=ODE_STATE)


def test_time_in_the_cost_discounts_it():
    """int e^t u^2 dt from 0 to 1 with x' = u: u = c e^-t."""
    plan = solved(
        rate=lambda x, u, p, t: [u[0]],  # noqa: ARG005
        start=[0],
        goal=[1],
        effort_limit=FREE_EFFORT,
        duration_s=1.0,
        running_cost=lambda x, u, p, t: ca.exp(t) * u[0] ** 2,  # noqa: ARG005
    )
    assert plan.objective == pytest.approx(1 / (1 - np.exp(-1)), rel=ODE_CLOSED_FORM)


@pytest.mark.slow
def test_time_in_a_free_duration_is_the_motion_s_own():
    """x' = t from 0 to 2 takes 2 s whatever the effort does; J = T + int u^2."""
    plan = solved(
        rate=lambda x, u, p, t: [t + 0 * u[0]],  # noqa: ARG005
        start=[0],
        goal=[2],
        effort_limit=[[-1, 1]],
        duration_s=(0.1, 10),
        running_cost=squared_effort,
        final_cost=duration,
    )
    assert plan.objective == pytest.approx(2.0, rel=ODE_CLOSED_FORM)


@pytest.mark.slow
def test_a_path_limit_that_falls_with_time_is_kept_at_every_instant():
    """x' = u <= 2 - t, x(1) as large as it gets: 3/2."""
    plan = solved(
        rate=lambda x, u, p, t: [u[0]],  # noqa: ARG005
        start=[0],
        goal=[NAN],
        effort_limit=[[-10, 10]],
        duration_s=1.0,
        path=lambda x, u, p, t: u[0] + t,  # noqa: ARG005
        path_limit=[[-INF, 2]],
        final_cost=lambda x0, xT, T, p: -xT[0],  # noqa: ARG005
    )
    assert plan.objective == pytest.approx(-1.5, abs=plan.objective_error)
    assert plan.objective_error < 1e-8
    time = plan.trajectory.dense_times(50)
    assert (plan.trajectory.effort_at(time)[:, 0] + time).max() <= 2 * (1 + ODE_LIMIT)


# Ends, returns, free states and durations.


@pytest.mark.slow
def test_a_distance_asked_between_two_free_ends_costs_its_square_over_time():
    plan = solved(
        rate=lambda x, u, p, t: [u[0]],  # noqa: ARG005
        start=[NAN],
        goal=[NAN],
        effort_limit=FREE_EFFORT,
        duration_s=(0.1, 10),
        ends=lambda x0, xT, T, p: xT[0] - x0[0],  # noqa: ARG005
        ends_limit=[[3, 3]],
        running_cost=squared_effort,
        final_cost=duration,
    )
    assert plan.objective == pytest.approx(2 * 3, rel=ODE_CLOSED_FORM)  # T + 9 / T at T = 3
    assert plan.trajectory.duration_s == pytest.approx(3, abs=ODE_STATE)


def test_a_bound_on_a_combination_of_ends_binds_on_its_cheaper_side():
    """x(T) + x(0) >= 4, x(T) - x(0) <= 1, cost x(0)^2 + int u^2 over T = 1: x(0) = 1.5, u = 1."""
    plan = solved(
        rate=lambda x, u, p, t: [u[0]],  # noqa: ARG005
        start=[NAN],
        goal=[NAN],
        effort_limit=FREE_EFFORT,
        duration_s=1.0,
        ends=lambda x0, xT, T, p: [xT[0] + x0[0], xT[0] - x0[0]],  # noqa: ARG005
        ends_limit=[[4, INF], [-INF, 1]],
        running_cost=squared_effort,
        final_cost=lambda x0, xT, T, p: x0[0] ** 2,  # noqa: ARG005
    )
    # Unbounded by the second, x(0) = 4/3 and u = 4/3: cost x0^2 + (4 - 2 x0)^2 least at x0 = 8/5, u = 4/5, which keeps it.
    assert plan.objective == pytest.approx((8 / 5) ** 2 + (4 / 5) ** 2, rel=ODE_CLOSED_FORM)


@pytest.mark.slow
@pytest.mark.parametrize("weight", [0.05, 2.0])
def test_a_periodic_follower_of_a_sinusoid_has_the_amplitude_of_its_fourier_balance(weight):
    omega, T = 3.0, 2 * np.pi / 3.0
    plan = solved(
        rate=lambda x, u, p, t: [u[0]],  # noqa: ARG005
        start=[NAN],
        goal=[NAN],
        returns=[0],
        effort_limit=FREE_EFFORT,
        duration_s=T,
        parameters=[omega, weight],
        running_cost=lambda x, u, p, t: (x[0] - ca.sin(p[0] * t)) ** 2 + p[1] * u[0] ** 2,
    )
    gain = weight * omega**2
    assert plan.objective == pytest.approx(T / 2 * gain / (1 + gain), rel=ODE_CLOSED_FORM)
    first, last = plan.trajectory.state_at([0.0, T])
    assert first == pytest.approx(last, abs=ODE_STATE)
    time = plan.trajectory.dense_times()
    np.testing.assert_allclose(plan.trajectory.state_at(time)[:, 0], np.sin(omega * time) / (1 + gain), atol=ODE_STATE)


@pytest.mark.slow
def test_a_free_first_state_is_the_cheapest():
    """x'' = u to rest at 1 within 1 s, beginning anywhere between 0 and 0.4 with any speed up to 0.5."""
    plan = solved(
        rate=double_integrator,
        start=[[0, 0.4], [0, 0.5]],
        goal=[1, 0],
        effort_limit=FREE_EFFORT,
        duration_s=1.0,
        running_cost=squared_effort,
    )
    # From (x, v) to (1, 0) in 1 s: 4 v^2 - 12 v d + 12 d^2 with d = 1 - x; both at their upper ends.
    d, v = 0.6, 0.5
    assert plan.objective == pytest.approx(4 * v**2 - 12 * v * d + 12 * d**2, rel=ODE_CLOSED_FORM)
    np.testing.assert_allclose(plan.trajectory.state_at([0.0])[0], [0.4, 0.5], atol=ODE_STATE)


@pytest.mark.slow
@pytest.mark.parametrize(("bounds", "T"), [((0.5, 2.0), 2.0), ((0.5, 0.9), 0.9)])
def test_less_effort_takes_the_longest_duration_allowed(bounds, T):
    plan = solved(
        rate=double_integrator,
        start=[0, 0],
        goal=[1, 0],
        effort_limit=FREE_EFFORT,
        duration_s=bounds,
        running_cost=squared_effort,
    )
    assert plan.trajectory.duration_s == pytest.approx(T, rel=ODE_CLOSED_FORM)
    assert plan.objective == pytest.approx(12 / T**3, rel=ODE_CLOSED_FORM)


@pytest.mark.slow
@pytest.mark.parametrize("weight", [0.1, 10.0])
def test_time_and_effort_are_balanced_where_their_sum_is_least(weight):
    """T + w 12 d^2 / T^3 is least at T^4 = 36 w d^2."""
    plan = solved(
        rate=double_integrator,
        start=[0, 0],
        goal=[2, 0],
        effort_limit=FREE_EFFORT,
        duration_s=(0.1, 100),
        parameters=[weight],
        running_cost=lambda x, u, p, t: p[0] * u[0] ** 2,  # noqa: ARG005
        final_cost=duration,
    )
    T = (36 * weight * 4) ** 0.25
    assert plan.trajectory.duration_s == pytest.approx(T, abs=ODE_STATE * T)
    assert plan.objective == pytest.approx(4 * T / 3, rel=ODE_CLOSED_FORM)


# Linear systems with quadratic cost.

PUSH = np.array([0.0, 1.0])


@pytest.mark.slow
@pytest.mark.parametrize("T", [1.0, 2 * np.pi])
def test_the_least_energy_to_move_an_oscillator_is_that_of_its_gramian(T):
    start, goal = np.array([0.5, -1.0]), np.array([1.0, 2.0])
    plan = solved(
        rate=oscillator, start=start, goal=goal, effort_limit=FREE_EFFORT, duration_s=T, running_cost=squared_effort
    )
    c, s = np.cos(2 * T), np.sin(2 * T)
    gramian = np.array([[T / 2 - s / 4, (1 - c) / 4], [(1 - c) / 4, T / 2 + s / 4]])
    missing = goal - expm(OSCILLATOR * T) @ start
    assert plan.objective == pytest.approx(missing @ np.linalg.solve(gramian, missing), rel=ODE_CLOSED_FORM)


@pytest.mark.slow
def test_a_regulator_over_a_finite_horizon_costs_what_riccati_s_equation_says():
    rng = np.random.default_rng(5)
    A, B = rng.normal(size=(3, 3)), rng.normal(size=(3, 2))
    Q, R, F = np.diag([1.0, 0.5, 2.0]), np.diag([0.7, 1.3]), np.diag([3.0, 1.0, 0.2])
    x0, T = np.array([1.0, -2.0, 0.5]), 2.0

    def riccati(t: float, flat: np.ndarray) -> np.ndarray:
        del t
        P = flat.reshape(3, 3)
        return (A.T @ P + P @ A - P @ B @ np.linalg.solve(R, B.T @ P) + Q).ravel()

    first = solve_ivp(riccati, (0, T), F.ravel(), method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1].reshape(3, 3)
    plan = solved(
        rate=lambda x, u, p, t: ca.DM(A) @ x + ca.DM(B) @ u,  # noqa: ARG005
        start=x0,
        goal=[NAN, NAN, NAN],
        effort_limit=[[-INF, INF]] * 2,
        duration_s=T,
        running_cost=lambda x, u, p, t: ca.bilin(ca.DM(Q), x) + ca.bilin(ca.DM(R), u),  # noqa: ARG005
        final_cost=lambda x0, xT, T, p: ca.bilin(ca.DM(F), xT),  # noqa: ARG005
    )
    assert plan.objective == pytest.approx(x0 @ first @ x0, rel=ODE_CLOSED_FORM)
    gain = -np.linalg.solve(R, B.T @ first) @ x0
    np.testing.assert_allclose(plan.trajectory.effort_at([0.0])[0], gain, atol=ODE_GAIN)


def test_the_gramian_of_the_oscillator_is_the_integral_that_defines_it():
    T = 1.0
    integral = quad_vec(lambda t: np.outer(expm(OSCILLATOR * t) @ PUSH, expm(OSCILLATOR * t) @ PUSH), 0, T)[0]
    c, s = np.cos(2 * T), np.sin(2 * T)
    np.testing.assert_allclose(integral, [[T / 2 - s / 4, (1 - c) / 4], [(1 - c) / 4, T / 2 + s / 4]], atol=ODE_CLOSED_FORM)


# Parameters.


@pytest.mark.slow
def test_parameters_enter_the_rate_the_cost_the_path_and_the_ends():
    """x' = a u, cost b int u^2 + c T, u <= d, x(T) - x(0) = e: with u = d all along, T = e / (a d)."""
    a, b, c, d, e = 2.0, 0.1, 5.0, 0.5, 3.0
    plan = solved(
        rate=lambda x, u, p, t: [p[0] * u[0]],  # noqa: ARG005
        start=[0],
        goal=[NAN],
        effort_limit=[[-9, 9]],
        duration_s=(0.1, 50),
        parameters=[a, b, c, d, e],
        running_cost=lambda x, u, p, t: p[1] * u[0] ** 2,  # noqa: ARG005
        final_cost=lambda x0, xT, T, p: p[2] * T,  # noqa: ARG005
        path=lambda x, u, p, t: u[0] - p[3],  # noqa: ARG005
        path_limit=[[-INF, 0]],
        ends=lambda x0, xT, T, p: xT[0] - x0[0] - p[4],  # noqa: ARG005
        ends_limit=[[0, 0]],
    )
    T = e / (a * d)
    assert plan.objective == pytest.approx(b * d**2 * T + c * T, rel=ODE_BOUND_BY_A_STATE)
