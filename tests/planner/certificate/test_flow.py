"""Integration in even steps of order eight: coefficients, answers, and where steps are too long."""

import warnings

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import DOP853, solve_ivp

from linkplan.planner.certificate import dormand_prince
from linkplan.planner.certificate.flow import _short, side_by_side, strides


def pendulum():
    x, u, tau = ca.SX.sym("x", 2), ca.SX.sym("u", 2), ca.SX.sym("tau")
    return ca.Function("rate", [x, u, tau], [ca.vertcat(x[1], -9.81 * ca.sin(x[0]) + u[0] + u[1] * tau)])


def test_the_coefficients_are_scipys():
    for i, row in enumerate(dormand_prince.A):
        np.testing.assert_array_equal(row, DOP853.A[i, :i])
    for name in ("B", "C", "E5", "E3"):
        np.testing.assert_array_equal(getattr(dormand_prince, name), getattr(DOP853, name))


def test_states_are_those_of_adaptive_steps():
    widths, inputs = np.array([0.05, 0.08, 0.03, 0.05, 0.06, 0.04]), np.random.default_rng(0).normal(0, 5, (6, 2))
    reached, state = strides(pendulum(), widths, inputs, np.array([1.0, 0.5])), np.array([1.0, 0.5])
    assert len(reached) == len(widths)
    for k, (h, (a, b)) in enumerate(zip(widths, inputs, strict=True)):
        right = lambda t, x, a=a, b=b, h=h: [x[1], -9.81 * np.sin(x[0]) + a + b * t / h]  # noqa: E731
        exact = solve_ivp(right, (0, h), state, method="DOP853", rtol=1e-13, atol=1e-14, t_eval=[h / 2, h]).y.T
        np.testing.assert_allclose(reached[k], exact, rtol=0, atol=2e-12)
        state = exact[-1]


def test_an_interval_with_too_long_steps_ends_what_is_returned():
    widths = np.array([0.05, 0.05, 3.0, 0.05])
    assert len(strides(pendulum(), widths, np.zeros((4, 2)), np.array([2.0, 0.0]))) == 2


def test_a_rate_that_is_not_a_number_ends_it_too():
    x, u, tau = ca.SX.sym("x"), ca.SX.sym("u"), ca.SX.sym("tau")
    rate = ca.Function("rate", [x, u, tau], [ca.sqrt(1.0 - x + 0 * u * tau)])
    assert len(strides(rate, np.full(20, 0.2), np.zeros((20, 1)), np.array([2.0]))) == 0


def test_a_step_to_infinity_is_too_long_without_a_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        short = _short(np.array([[1.0, 1.0]]), np.array([[np.inf, 1.0]]), np.array([[np.inf, 0.0], [np.inf, 0.0]]), 1, 1e-11)
    assert short.tolist() == [False, True]


def test_intervals_side_by_side_go_each_from_its_own_state_where_even_steps_do_and_where_they_are_too_long():
    widths, inputs = np.array([0.05, 3.0, 0.04]), np.random.default_rng(1).normal(0, 5, (3, 2))
    states, shares = np.array([[1.0, 0.5], [2.0, 0.0], [-1.0, 3.0]]), np.array([0.1, 0.5, 0.8, 1.0])
    reached = side_by_side(pendulum(), widths, inputs, states, shares)
    for k, (h, (a, b)) in enumerate(zip(widths, inputs, strict=True)):
        right = lambda t, x, a=a, b=b, h=h: [x[1], -9.81 * np.sin(x[0]) + a + b * t / h]  # noqa: E731
        exact = solve_ivp(right, (0, h), states[k], method="DOP853", rtol=1e-13, atol=1e-14, t_eval=shares * h).y.T
        np.testing.assert_allclose(reached[k], exact, rtol=0, atol=2e-10)


def test_intervals_side_by_side_are_none_where_one_fails():
    x, u, tau = ca.SX.sym("x"), ca.SX.sym("u"), ca.SX.sym("tau")
    rate = ca.Function("rate", [x, u, tau], [x**2 + 0 * u * tau])  # x = 1 / (1 / x_0 - t)
    shares, begins = np.array([0.5, 1.0]), np.array([[0.1], [0.5]])
    assert side_by_side(rate, np.full(2, 1.0), np.zeros((2, 1)), begins, shares) is not None
    assert side_by_side(rate, np.full(2, 3.0), np.zeros((2, 1)), begins, shares) is None


@pytest.mark.parametrize(
    ("fifth", "third", "is_short"), [(2.0, 2.0, False), (0.9, 0.0, True), (0.9, 0.9, True), (1.1, 1.1, False)]
)
def test_the_error_of_a_step_weighs_its_estimates_as_hairer_norsett_and_wanner_do(fifth, third, is_short):
    """err = err5^2 / sqrt((err5^2 + err3^2 / 100) n) <= 1, with both in units of the tolerance (II.10, after (10.17))."""
    state = np.zeros((1, 1))
    tolerance = 1e-13
    assert _short(state, state, tolerance * np.array([[fifth], [third]]), 1, 1e-12).tolist() == [is_short]


@pytest.mark.parametrize(("before", "after", "allowed"), [(0.2, 0.1, 0.3), (3.0, -5.0, 5.3), (-5.0, 3.0, 5.5)])
def test_the_error_allowed_in_a_step_is_that_of_the_larger_end_and_a_tenth_of_the_first(before, after, allowed):
    """Of the tolerance; a tenth of one at least, for states that pass through zero."""
    for share, is_short in ((0.99, True), (1.01, False)):
        errors = 1e-12 * np.array([[share * allowed], [0.0]])
        assert _short(np.array([[before]]), np.array([[after]]), errors, 1, 1e-12).tolist() == [is_short]
