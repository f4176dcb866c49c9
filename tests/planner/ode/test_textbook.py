"""Textbook optimal-control problems with known optima, by `plan_ode`: least time, least effort, local and best optima."""

from collections.abc import Callable
from functools import cache

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.optimize import fsolve

from linkplan.planner.ode.plan import OdePlan
from linkplan.planner.ode.problem import StateGuess
from tests.support.ode import (
    FREE_EFFORT,
    FREE_STATE,
    INF,
    NAN,
    bryson_denham,
    double_integrator,
    duration,
    solved,
    squared_effort,
)
from tests.support.tolerances_planner import (
    ODE_BOUND_BY_A_STATE,
    ODE_CLOSED_FORM,
    ODE_COSTATES,
    ODE_FOUR_DIGITS,
    ODE_INTEGRATED,
    ODE_LIMIT,
    ODE_PUBLISHED,
    ODE_STATE,
    ODE_SWITCH,
)

# Double integrator.


@cache
def rest_to_rest_in_least_time(distance: float, effort: float) -> OdePlan:
    return solved(
        rate=double_integrator,
        start=[0, 0],
        goal=[distance, 0],
        effort_limit=[[-effort, effort]],
        duration_s=(0.01, 100),
        final_cost=duration,
    )


@pytest.mark.slow
@pytest.mark.parametrize(("distance", "effort"), [(1.0, 1.0), (3.0, 0.5), (-2.0, 7.0)])
def test_a_double_integrator_s_least_time_is_twice_the_root_of_distance_over_effort(distance, effort):
    plan = rest_to_rest_in_least_time(distance, effort)
    exact = 2 * np.sqrt(abs(distance) / effort)
    assert plan.objective == pytest.approx(exact, rel=ODE_CLOSED_FORM)
    assert plan.trajectory.duration_s == pytest.approx(exact, rel=ODE_CLOSED_FORM)


@pytest.mark.slow
def test_a_double_integrator_of_least_time_switches_once_in_the_middle():
    motion = rest_to_rest_in_least_time(3.0, 0.5).trajectory
    time, middle = motion.dense_times(50), np.sqrt(3.0 / 0.5)
    time = time[np.abs(time - middle) > ODE_SWITCH]
    np.testing.assert_allclose(motion.effort_at(time)[:, 0], np.where(time < middle, 0.5, -0.5), atol=ODE_STATE)


@cache
def rest_to_rest_with_least_effort() -> OdePlan:
    return solved(
        rate=double_integrator,
        start=[0, 0],
        goal=[2, 0],
        effort_limit=FREE_EFFORT,
        duration_s=1.5,
        running_cost=squared_effort,
    )


def test_a_double_integrator_s_least_effort_is_twelve_distance_squared_over_time_cubed():
    assert rest_to_rest_with_least_effort().objective == pytest.approx(12 * 2**2 / 1.5**3, rel=ODE_CLOSED_FORM)


def test_a_double_integrator_of_least_effort_follows_the_cubic_with_a_linear_effort():
    motion = rest_to_rest_with_least_effort().trajectory
    time = motion.dense_times(20)
    tau = time / 1.5
    np.testing.assert_allclose(motion.effort_at(time)[:, 0], 6 * 2 / 1.5**2 * (1 - 2 * tau), atol=ODE_STATE)
    np.testing.assert_allclose(motion.state_at(time)[:, 0], 2 * (3 * tau**2 - 2 * tau**3), atol=ODE_STATE)


# Published optima.

G = 9.8


def falling_bead(x, u, p, t):  # noqa: ARG001
    return [x[2] * ca.sin(u[0]), x[2] * ca.cos(u[0]), G * ca.cos(u[0])]


@cache
def brachistochrone() -> OdePlan:
    return solved(
        rate=falling_bead,
        start=[0, 0, 0],
        goal=[2, 2, NAN],
        effort_limit=[[0, np.pi]],
        duration_s=(0.1, 10),
        final_cost=duration,
    )


@pytest.mark.slow
def test_the_brachistochrone_takes_the_cycloid_s_time():
    theta = fsolve(lambda a: (a - np.sin(a)) / (1 - np.cos(a)) - 1, 2.4, xtol=1e-15)[0]
    cycloid = theta * np.sqrt(2 / (1 - np.cos(theta)) / G)
    assert cycloid == pytest.approx(0.8247591431566, rel=ODE_CLOSED_FORM)  # the figure that is published
    assert brachistochrone().objective == pytest.approx(cycloid, rel=ODE_CLOSED_FORM)


@pytest.mark.slow
def test_the_brachistochrone_is_the_cycloid():
    motion = brachistochrone().trajectory
    time = motion.dense_times()
    theta = fsolve(lambda a: (a - np.sin(a)) / (1 - np.cos(a)) - 1, 2.4, xtol=1e-15)[0]
    radius = 2 / (1 - np.cos(theta))
    angle = time * np.sqrt(G / radius)
    cycloid = radius * np.column_stack([angle - np.sin(angle), 1 - np.cos(angle)])
    np.testing.assert_allclose(motion.state_at(time)[:, :2], cycloid, atol=ODE_STATE)


def test_kirk_s_example_5_1_1_costs_what_is_published():
    plan = solved(
        rate=lambda x, u, p, t: [x[1], -x[1] + u[0]],  # noqa: ARG005
        start=[0, 0],
        goal=[5, 2],
        effort_limit=FREE_EFFORT,
        duration_s=2.0,
        running_cost=lambda x, u, p, t: u[0] ** 2 / 2,  # noqa: ARG005
    )
    assert plan.objective == pytest.approx(16.7507234, rel=ODE_PUBLISHED)


def cart_pole(x, u, p, t):  # noqa: ARG001
    m1, m2, length, gravity = 1.0, 0.3, 0.5, 9.81
    s, c = ca.sin(x[1]), ca.cos(x[1])
    a1 = (length * m2 * s * x[3] ** 2 + u[0] + m2 * gravity * c * s) / (m1 + m2 * (1 - c**2))
    a2 = -(length * m2 * c * s * x[3] ** 2 + u[0] * c + (m1 + m2) * gravity * s) / (length * m1 + length * m2 * (1 - c**2))
    return [x[2], x[3], a1, a2]


@cache
def cart_pole_swing_up(halfway: float | None = None) -> OdePlan:
    """Return the plan from the straight line, or from a guess with an angle [rad] of the pole in its middle."""
    swing = [] if halfway is None else [StateGuess(state=[[0, 0, 0, 0], [0, halfway, 0, 0], [1, np.pi, 0, 0]])]
    return solved(
        rate=cart_pole,
        start=[0, 0, 0, 0],
        goal=[1, np.pi, 0, 0],
        effort_limit=[[-20, 20]],
        state_limit=[[-2, 2], FREE_STATE, FREE_STATE, FREE_STATE],
        duration_s=2.0,
        running_cost=squared_effort,
        guesses=swing,
    )


SWINGS = (None, -np.pi / 3)


@pytest.mark.slow
@pytest.mark.parametrize(("halfway", "published"), [(SWINGS[0], 58.8077), (SWINGS[1], 57.9449)])
def test_the_cart_pole_s_optima_are_the_published_ones(halfway, published):
    """From the linear guess the nearby optimum, from a guess that swings back first the better one."""
    assert cart_pole_swing_up(halfway).objective == pytest.approx(published, rel=ODE_FOUR_DIGITS)


# Residual that solve_bvp is asked for, relative; where the effort has kinks it needs thousands of nodes for less.
SOLVE_BVP = 1e-7


def extremal(plan: OdePlan, effort_of: Callable[[np.ndarray], np.ndarray]) -> float:
    """Return the cost of the extremal next to a plan: Pontryagin's conditions as a boundary-value problem, by solve_bvp.

    The running cost is that of the problem, `effort_of` (B' lambda) the effort that makes the Hamiltonian least, f being
    affine in u. First costates come from the plan: those that fit its effort best.
    """
    problem, motion = plan.problem, plan.trajectory
    n, T = problem.n_x, motion.duration_s
    x, u, lam = ca.SX.sym("x", n), ca.SX.sym("u", 1), ca.SX.sym("lam", n)
    p, t = ca.SX(0, 1), ca.SX(0)
    f, L = problem.function("rate")(x, u, p, t), problem.function("running_cost")(x, u, p, t)
    hamiltonian = L + ca.dot(lam, f)
    rates = ca.Function("rates", [x, lam, u], [ca.vertcat(f, -ca.gradient(hamiltonian, x), L)])
    drive = ca.Function("drive", [x, lam], [ca.dot(lam, ca.jacobian(f, u))])

    def effort(y: np.ndarray) -> np.ndarray:
        return effort_of(np.array(drive(y[:n], y[n : 2 * n])).ravel())

    def rate(time: np.ndarray, y: np.ndarray) -> np.ndarray:
        del time
        return np.array(rates(y[:n], y[n : 2 * n], effort(y)[None]))

    def residual(first: np.ndarray, last: np.ndarray) -> np.ndarray:
        return np.concatenate([first[:n] - problem.start[:, 0], last[:n] - problem.goal[:, 0], first[2 * n :]])

    # Costates along the plan are linear in their first values: carry a basis along by Runge and Kutta's rule, fit the
    # effort.
    time = np.linspace(0.0, T, 401)

    def costate_rates(at: float, costates: np.ndarray) -> np.ndarray:
        state, control = motion.state_at([at]).T, motion.effort_at([at]).T
        return np.array(rates(state, costates.T, control))[n : 2 * n].T

    along = [np.vstack([np.zeros(n), np.eye(n)])]
    for at, h in zip(time[:-1], np.diff(time), strict=True):
        k1 = costate_rates(at, along[-1])
        k2 = costate_rates(at + h / 2, along[-1] + h / 2 * k1)
        k3 = costate_rates(at + h / 2, along[-1] + h / 2 * k2)
        k4 = costate_rates(at + h, along[-1] + h * k3)
        along.append(along[-1] + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
    along = np.moveaxis(np.array(along), 0, 2)
    state = motion.state_at(time).T
    free = (
        np.abs(motion.effort_at(time)[:, 0] - np.clip(motion.effort_at(time)[:, 0], *(problem.effort_limit[0] * 0.999))) == 0
    )
    driven = np.array([np.array(drive(state, along[k])).ravel() for k in range(n + 1)])
    # Where it is free, u = -B' lambda / 2 (cost u^2).
    columns = (driven[1:] - driven[0])[:, free].T
    first = np.linalg.lstsq(columns, -2 * motion.effort_at(time)[free, 0] - driven[0][free], rcond=None)[0]
    costate = along[0] + np.einsum("k,knt->nt", first, along[1:] - along[0])
    guess = np.vstack([state, costate, np.zeros((1, len(time)))])
    answer = solve_bvp(rate, residual, time, guess, tol=SOLVE_BVP, max_nodes=20_000)
    assert answer.success, answer.message
    return float(answer.y[-1, -1])


@pytest.mark.slow
@pytest.mark.parametrize("halfway", SWINGS)
def test_the_cart_pole_s_optima_satisfy_pontryagin_s_conditions(halfway):
    plan = cart_pole_swing_up(halfway)
    cost = extremal(plan, lambda drive: np.clip(-drive / 2, -20, 20))
    assert plan.objective == pytest.approx(cost, rel=ODE_COSTATES)


# Bryson and Denham: a state limit that is not reached, touched, or held.


@pytest.mark.slow
@pytest.mark.parametrize(
    ("limit", "exact"),
    [(0.3, 2.0), (0.2, 2 + 6 * (1 - 4 * 0.2) ** 2), (1 / 9, 4.0), (0.125, 4 / (9 * 0.125))],
    ids=["not reached", "touched", "held, 1/9", "held, 1/8"],
)
def test_bryson_and_denham_s_problem_costs_its_closed_form(limit, exact):
    plan = solved(bryson_denham(limit, 1e-7))
    assert plan.objective == pytest.approx(exact, rel=ODE_BOUND_BY_A_STATE)
    motion = plan.trajectory
    assert motion.state_at(motion.dense_times(100))[:, 0].max() <= limit * (1 + ODE_LIMIT)


# Van der Pol's oscillator.


@cache
def van_der_pol_plan(low: float, high: float) -> OdePlan:
    return solved(
        rate=lambda x, u, p, t: [(1 - x[1] ** 2) * x[0] - x[1] + u[0], x[0]],  # noqa: ARG005
        start=[0, 1],
        goal=[0, 0],
        effort_limit=[[low, high]],
        duration_s=10.0,
        running_cost=lambda x, u, p, t: x[0] ** 2 + x[1] ** 2 + u[0] ** 2,  # noqa: ARG005
        objective_tolerance=1e-8,
    )


@pytest.mark.slow
@pytest.mark.parametrize(("low", "high"), [(-INF, INF), (-0.75, 1.0), (-INF, 0.8)])
def test_van_der_pol_s_oscillator_costs_what_pontryagin_s_conditions_say(low, high):
    plan = van_der_pol_plan(low, high)
    cost = extremal(plan, lambda drive: np.clip(-drive / 2, low, high))
    assert plan.objective == pytest.approx(cost, rel=ODE_COSTATES)


# What holds of every one of them.


@pytest.mark.slow
@pytest.mark.parametrize(
    "plan_of",
    [
        lambda: rest_to_rest_in_least_time(3.0, 0.5),
        rest_to_rest_with_least_effort,
        brachistochrone,
        lambda: cart_pole_swing_up(),
    ],
    ids=["least time", "least effort", "brachistochrone", "cart-pole"],
)
def test_the_objective_is_that_of_the_integrated_motion(plan_of):
    plan = plan_of()
    assert plan.certificate.passed
    assert plan.objective == pytest.approx(plan.certificate.integrated_objective, rel=ODE_INTEGRATED)
    assert plan.certificate.integration_error <= plan.problem.tolerance
