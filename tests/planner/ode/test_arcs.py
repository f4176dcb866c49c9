"""Optimal-control problems of bang, limited and singular arcs with known optima: switches, currents, path limits."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq, minimize

from linkplan.planner.ode.plan import OdePlan
from linkplan.planner.ode.problem import OdeProblem, StateGuess
from linkplan.planner.problem.settings import MeshSettings
from tests.support.ode import INF, NAN, OSCILLATOR, double_integrator, duration, oscillator, solved
from tests.support.tolerances_planner import (
    COPS_CATALYST,
    COPS_ROCKET,
    ODE_CLOSED_FORM,
    ODE_KINKED,
    ODE_LIMIT,
    ODE_SINGULAR,
    ODE_SINGULAR_ARC,
    ODE_STATE,
    ODE_SWITCH,
)

# Least time with several switches.


@cache
def oscillator_to_rest(last: float, first: float, switches: int) -> tuple[OdePlan, np.ndarray]:
    """Return the quickest way of an oscillator to rest, from where it is built backwards, and its exact switch times [s].

    Bang arcs of +1 and -1 in turn, the last of them +1 for `last` s, `switches` - 1 before it of pi each, and one of
    `first`.
    """
    arcs = [first, *[np.pi] * (switches - 1), last]
    state, effort = np.zeros(2), 1.0
    for length in reversed(arcs):
        centre = np.array([effort, 0.0])
        state, effort = centre + expm(-OSCILLATOR * length) @ (state - centre), -effort
    plan = solved(
        rate=oscillator,
        start=state,
        goal=[0, 0],
        effort_limit=[[-1, 1]],
        duration_s=(0.1, 30),
        final_cost=duration,
        guesses=[StateGuess(state=[state, [0, 0]], duration_s=sum(arcs) + 1)],
    )
    return plan, np.cumsum(arcs)


@pytest.mark.slow
@pytest.mark.parametrize(("last", "first", "switches"), [(1.0, 2.0, 1), (1.0, 2.0, 2), (2.5, 0.7, 3)])
def test_an_oscillator_comes_to_rest_in_the_time_of_its_arcs(last, first, switches):
    plan, ends = oscillator_to_rest(last, first, switches)
    assert plan.objective == pytest.approx(ends[-1], rel=ODE_CLOSED_FORM)


@pytest.mark.slow
def test_an_oscillator_switches_every_half_period():
    plan, ends = oscillator_to_rest(2.5, 0.7, 3)
    time = plan.trajectory.dense_times(4)
    effort = plan.trajectory.effort_at(time)[:, 0]
    np.testing.assert_allclose(time[np.flatnonzero(np.diff(np.sign(effort)))], ends[:-1], atol=ODE_SWITCH)


@pytest.mark.slow
def test_production_is_invested_until_one_time_constant_is_left():
    """x' = u x, int (1 - u) x dt as large as it gets over 3 s: invest for 2 s, then consume e^2."""
    plan = solved(
        rate=lambda x, u, p, t: [u[0] * x[0]],  # noqa: ARG005
        start=[1],
        goal=[NAN],
        effort_limit=[[0, 1]],
        duration_s=3.0,
        running_cost=lambda x, u, p, t: -(1 - u[0]) * x[0],  # noqa: ARG005
    )
    assert plan.objective == pytest.approx(-np.exp(2), rel=ODE_CLOSED_FORM)
    effort = plan.trajectory.effort_at([0.0, 1.99, 2.01, 2.99])[:, 0]
    np.testing.assert_allclose(effort, [1, 1, 0, 0], atol=ODE_STATE)


# Zermelo: a boat in a current.

BOAT = 1.0


@pytest.mark.slow
def test_a_boat_in_an_even_current_takes_the_way_that_meets_the_goal():
    current, goal = np.array([0.4, -0.3]), np.array([3.0, 2.0])
    plan = solved(
        rate=lambda x, u, p, t: [BOAT * ca.cos(u[0]) + current[0], BOAT * ca.sin(u[0]) + current[1]],  # noqa: ARG005
        start=[0, 0],
        goal=goal,
        effort_limit=[[-np.pi, np.pi]],
        duration_s=(0.1, 50),
        final_cost=duration,
    )
    exact = brentq(lambda T: np.linalg.norm(goal - current * T) - BOAT * T, 0.1, 50, xtol=1e-14)
    assert plan.objective == pytest.approx(exact, rel=ODE_CLOSED_FORM)


# Limits on paths.


def quickest_cart(**limits) -> OdePlan:
    return solved(
        rate=double_integrator,
        start=[0, 0],
        goal=[2, 0],
        effort_limit=[[-1, 1]],
        duration_s=(0.1, 20),
        final_cost=duration,
        objective_tolerance=1e-7,
        **limits,
    )


@pytest.mark.slow
def test_a_speed_limit_on_a_cart_makes_a_trapezium():
    plan = quickest_cart(state_limit=[[-INF, INF], [-INF, 0.8]])
    assert plan.objective == pytest.approx(2 / 0.8 + 0.8, rel=ODE_CLOSED_FORM)
    assert plan.trajectory.state_at(plan.trajectory.dense_times(50))[:, 1].max() <= 0.8 * (1 + ODE_LIMIT)


@pytest.mark.slow
def test_a_power_limit_on_a_cart_makes_energy_grow_with_time():
    """Full effort up to speed P, then v^2 = P^2 + 2 P t, then full braking."""
    P = 0.5
    plan = quickest_cart(path=lambda x, u, p, t: u[0] * x[1], path_limit=[[-INF, P]])  # noqa: ARG005
    top = brentq(lambda v: P**2 / 2 + (v**3 - P**3) / (3 * P) + v**2 / 2 - 2, P, 3, xtol=1e-14)
    assert plan.objective == pytest.approx(P + (top**2 - P**2) / (2 * P) + top, rel=ODE_CLOSED_FORM)
    motion = plan.trajectory
    time = motion.dense_times(50)
    assert (motion.effort_at(time)[:, 0] * motion.state_at(time)[:, 1]).max() <= P * (1 + ODE_LIMIT)


def test_an_equality_on_the_path_is_kept_at_every_instant():
    """Two efforts tied by u0 = 2 u1, x'' = u0 + u1 with cost u0^2 + u1^2: as one effort of 3 u1 with cost 5 u1^2."""
    plan = solved(
        rate=lambda x, u, p, t: [x[1], u[0] + u[1]],  # noqa: ARG005
        start=[0, 0],
        goal=[1, 0],
        effort_limit=[[-INF, INF]] * 2,
        duration_s=1.0,
        path=lambda x, u, p, t: u[0] - 2 * u[1],  # noqa: ARG005
        path_limit=[[0, 0]],
        running_cost=lambda x, u, p, t: u[0] ** 2 + u[1] ** 2,  # noqa: ARG005
    )
    assert plan.objective == pytest.approx(12 * 5 / 9, rel=ODE_CLOSED_FORM)


# Singular arcs.


@pytest.mark.slow
def test_aly_and_chan_s_singular_problem_costs_nothing():
    """int (x2^2 - x1^2) / 2 over a quarter turn with x1' = x2, x2' = u from (0, 1): u = -sin t, J = 0."""
    plan = solved(
        rate=double_integrator,
        start=[0, 1],
        goal=[NAN, NAN],
        effort_limit=[[-1, 1]],
        duration_s=np.pi / 2,
        mesh=MeshSettings(intervals=10),
        running_cost=lambda x, u, p, t: (x[1] ** 2 - x[0] ** 2) / 2,  # noqa: ARG005
    )
    assert plan.objective == pytest.approx(0.0, abs=ODE_SINGULAR)


# Goddard's rocket in COPS's units: falloff of the air, speed of the exhaust, largest thrust.
FALLOFF, EXHAUST, THRUST_LIMIT = 500.0, 0.5, 3.5


def forces(h, v, exp=np.exp):
    """Return the drag and the weight of a unit of mass at a height and a speed."""
    return 310.0 * v**2 * exp(-FALLOFF * (h - 1)), 1 / h**2


def goddard(**more) -> OdeProblem:
    """Return the problem of the greatest height."""

    def rate(x, u, p, t):  # noqa: ARG001
        D, g = forces(x[0], x[1], ca.exp)
        return [x[1], (u[0] - D) / x[2] - g, -u[0] / EXHAUST]

    return OdeProblem(
        name="Goddard's rocket",
        rate=rate,
        start=[1, 0, 1],
        goal=[NAN, NAN, 0.6],
        effort_limit=[[0, THRUST_LIMIT]],
        state_limit=[[1, INF], [0, INF], [0.6, 1]],
        duration_s=(0.01, 1),
        final_cost=lambda x0, xT, T, p: -xT[0],  # noqa: ARG005
        **more,
    )


@pytest.mark.slow
def test_a_rocket_s_height_is_that_of_its_bang_singular_and_coasting_arcs():
    """Full thrust, the singular arc, no thrust; scipy takes the two switches."""

    def singular_thrust(y: np.ndarray) -> float:
        """Return the thrust that keeps m g = (1 + v / c) D, from that equation's derivative."""
        h, v, m = y
        D, g = forces(h, v)
        Dh, Dv, gh = -FALLOFF * D, 2 * D / v, -2 / h**3
        slope = np.array([Dh * (1 + v / EXHAUST) - m * gh, Dv * (1 + v / EXHAUST) + D / EXHAUST, -g])
        drift = np.array([v, -D / m - g, 0.0])
        push = np.array([0.0, 1 / m, -1 / EXHAUST])
        return -(slope @ drift) / (slope @ push)

    def rate(t: float, y: np.ndarray, law) -> list[float]:
        del t
        D, g = forces(y[0], y[1])
        T = law(y)
        return [y[1], (T - D) / y[2] - g, -T / EXHAUST]

    def on_surface(t, y, law):
        del t, law
        D, g = forces(y[0], y[1])
        return D * (1 + y[1] / EXHAUST) - y[2] * g

    def burnt(t, y, law):
        del t, law
        return y[2] - 0.6

    def top(t, y, law):
        del t, law
        return y[1]

    state = np.array([1.0, 0.0, 1.0])
    for law, until in ((lambda y: THRUST_LIMIT, on_surface), (singular_thrust, burnt), (lambda y: 0.0, top)):  # noqa: ARG005
        until.terminal = True
        arc = solve_ivp(
            rate, (0, 1), state, args=(law,), events=until, method="DOP853", rtol=1e-11, atol=1e-13, first_step=1e-4
        )
        assert arc.status == 1
        state = arc.y[:, -1]
    assert state[0] == pytest.approx(1.01283, abs=COPS_ROCKET)  # COPS

    plan = solved(goddard(guesses=[StateGuess(state=[[1, 0.05, 1], [1.01, 0.05, 0.6]], duration_s=0.2)]))
    assert -plan.objective - 1 == pytest.approx(state[0] - 1, rel=ODE_SINGULAR_ARC)


@pytest.mark.long
def test_a_rocket_s_height_is_found_to_eight_digits_without_a_guess_or_chatter():
    """The height is that of the test above, to 1e-11."""
    assert -solved(goddard()).objective - 1 == pytest.approx(0.0128369183, rel=ODE_KINKED)


@pytest.mark.slow
def test_catalysts_are_mixed_by_a_bang_a_singular_arc_and_a_rest():
    """COPS's problem: x' = A(u) x, linear in x, so that two switches and the constant singular effort give it exactly."""

    def matrix(u: float) -> np.ndarray:
        return np.array([[-u, 10 * u], [u, -10 * u - (1 - u)]])

    def left(unknowns: np.ndarray) -> float:
        t1, t2, u = unknowns
        state = expm(matrix(0.0) * (1 - t2)) @ expm(matrix(u) * (t2 - t1)) @ expm(matrix(1.0) * t1) @ [1.0, 0.0]
        return float(state.sum() - 1)

    best = minimize(left, [0.14, 0.73, 0.23], method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-15}).fun
    assert best == pytest.approx(-0.0480556, abs=COPS_CATALYST)  # COPS
    plan = solved(
        rate=lambda x, u, p, t: [  # noqa: ARG005
            u[0] * (10 * x[1] - x[0]),
            u[0] * (x[0] - 10 * x[1]) - (1 - u[0]) * x[1],
        ],
        start=[1, 0],
        goal=[NAN, NAN],
        effort_limit=[[0, 1]],
        duration_s=1.0,
        final_cost=lambda x0, xT, T, p: xT[0] + xT[1] - 1,  # noqa: ARG005
    )
    assert plan.objective == pytest.approx(best, rel=ODE_SINGULAR)
