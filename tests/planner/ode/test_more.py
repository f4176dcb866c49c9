"""More textbook optima by `plan_ode` at its default settings: angles that wind, ways that bend, arcs that are singular."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq, fsolve

from linkplan.planner.ode.certificate import LIMIT_SLACK, OVERRUN_SHARE
from linkplan.planner.ode.plan import plan_ode
from linkplan.planner.ode.problem import OdeProblem, StateGuess
from tests.support.ode import FREE_EFFORT, INF, NAN, double_integrator, duration, solved
from tests.support.tolerances_planner import (
    BOOK_TIME,
    COPS_GLIDER,
    FIVE_DIGITS,
    ODE_CLOSED_FORM,
    ODE_EFFORT,
    ODE_FOUR_DIGITS,
    ODE_INTEGRATED,
    ODE_INTEGRATED_ROUGHLY,
    ODE_KINKED,
    ODE_PUBLISHED,
    ODE_STATE,
    ODE_STATE_ARCS,
    SIX_DIGITS,
)

# Angles: what acts through sine and cosine alone may leap by whole turns from node to node.


@pytest.mark.slow
def test_zermelo_s_boat_crosses_the_current_in_its_least_time():
    """Current -y along x, speed 1, from (3.66, -1.86) to the origin; theta' = cos^2 theta (Bryson & Ho, 2.7)."""

    def missed(unknowns: np.ndarray) -> np.ndarray:
        heading, T = unknowns

        def rate(t: float, y: np.ndarray) -> list[float]:
            del t
            return [np.cos(y[2]) - y[1], np.sin(y[2]), np.cos(y[2]) ** 2]

        return solve_ivp(rate, (0, T), [3.66, -1.86, heading], method="DOP853", rtol=1e-12, atol=1e-13).y[:2, -1]

    heading, T = fsolve(missed, [np.radians(105), 5.46], xtol=1e-13)
    assert pytest.approx(5.46, abs=BOOK_TIME) == T  # the book's figure
    plan = solved(
        rate=lambda x, u, p, t: [ca.cos(u[0]) - x[1], ca.sin(u[0])],  # noqa: ARG005
        start=[3.66, -1.86],
        goal=[0, 0],
        effort_limit=FREE_EFFORT,
        duration_s=(0.1, 100),
        final_cost=duration,
    )
    assert plan.objective == pytest.approx(T, rel=ODE_CLOSED_FORM)
    assert np.exp(1j * plan.trajectory.effort_at([0.0])[0, 0]) == pytest.approx(np.exp(1j * heading), abs=ODE_EFFORT)
    # Between the nodes the heading is no wild polynomial: within an interval it turns by what it may turn in that time.
    turn = np.ptp(plan.trajectory.effort, axis=0)[:, 0]
    assert np.all(turn <= np.diff(plan.trajectory.breaks_s) + ODE_STATE)


@pytest.mark.slow
def test_a_thrust_turns_an_orbit_as_large_as_bryson_and_ho_say():
    plan = solved(
        rate=lambda x, u, p, t: [  # noqa: ARG005
            x[1],
            x[2] ** 2 / x[0] - 1 / x[0] ** 2 + 0.1405 * ca.sin(u[0]) / (1 - 0.07487 * t),
            -x[1] * x[2] / x[0] + 0.1405 * ca.cos(u[0]) / (1 - 0.07487 * t),
        ],
        start=[1, 0, 1],
        goal=[NAN, 0, NAN],
        effort_limit=FREE_EFFORT,
        duration_s=3.32,
        ends=lambda x0, xT, T, p: xT[2] - 1 / ca.sqrt(xT[0]),  # noqa: ARG005
        ends_limit=[[0, 0]],
        final_cost=lambda x0, xT, T, p: -xT[0],  # noqa: ARG005
    )
    assert -plan.objective == pytest.approx(1.52525, abs=FIVE_DIGITS)  # 1.5253 in the book


@pytest.mark.slow
def test_a_particle_is_steered_in_the_time_of_the_linear_tangent_law():
    """COPS's problem: thrust 100 to height 5 and speed 45 along x; tan theta = k (1 - 2 t / T)."""

    def missed(unknowns: np.ndarray) -> list[float]:
        k, T = unknowns
        speed = quad(lambda s: np.cos(np.arctan(k * (1 - 2 * s))), 0, 1, epsabs=1e-13)[0]
        height = quad(lambda s: (1 - s) * np.sin(np.arctan(k * (1 - 2 * s))), 0, 1, epsabs=1e-13)[0]
        return [100 * T * speed - 45, 100 * T**2 * height - 5]

    T = fsolve(missed, [1.0, 0.55], xtol=1e-13)[1]
    assert pytest.approx(0.554571, abs=SIX_DIGITS) == T  # COPS
    plan = solved(
        rate=lambda x, u, p, t: [x[2], x[3], 100 * ca.cos(u[0]), 100 * ca.sin(u[0])],  # noqa: ARG005
        start=[0, 0, 0, 0],
        goal=[NAN, 5, 45, 0],
        effort_limit=[[-np.pi / 2, np.pi / 2]],
        duration_s=(0.01, 10),
        final_cost=duration,
    )
    assert plan.objective == pytest.approx(T, rel=ODE_CLOSED_FORM)


# Ways that no straight line shows.


def shortest_dubins(x: float, y: float, heading: float) -> float:
    """Return the length of the shortest arc-line-arc of radius 1 from (0, 0) along x whose turns add up to a heading."""
    best = np.inf
    for first in (1, -1):
        for last in (1, -1):
            centre = np.array([x - last * np.sin(heading), y + last * np.cos(heading) - first])
            between, angle = np.hypot(*centre), np.arctan2(centre[1], centre[0])
            if first != last and between < 2:
                continue
            line = between if first == last else np.sqrt(between**2 - 4)
            angle += 0.0 if first == last else first * np.arctan2(2, line)
            turns = np.array([first * angle, last * (heading - angle)]) % (2 * np.pi)
            for whole in ((0, 0), (0, 1), (1, 0), (1, 1)):
                arcs = turns + 2 * np.pi * np.array(whole)
                if abs(first * arcs[0] + last * arcs[1] - heading) < 1e-9:
                    best = min(best, arcs.sum() + line)
    return best


@pytest.mark.slow
@pytest.mark.parametrize(
    ("goal", "on_the_way"),
    [((5, 1, -np.pi / 3), ()), ((-3, 2, 0.0), [(0, 2, np.pi), (-3, 2, np.pi)])],
    ids=["right", "behind"],
)
def test_dubins_car_takes_the_shortest_arcs_and_line(goal, on_the_way):
    problem = OdeProblem(
        name="Dubins' car",
        rate=lambda x, u, p, t: [ca.cos(x[2]), ca.sin(x[2]), u[0]],  # noqa: ARG005
        start=[0, 0, 0],
        goal=goal,
        effort_limit=[[-1, 1]],
        duration_s=(0.1, 50),
        final_cost=duration,
        guesses=[StateGuess(state=[(0, 0, 0), *on_the_way, goal], duration_s=10.0)] if on_the_way else [],
    )
    if on_the_way:
        failed = plan_ode(replace(problem, guesses=[]))
        assert failed.status == "failed"
        assert "no start led to a solution" in failed.message
    plan = solved(problem)
    assert plan.objective == pytest.approx(shortest_dubins(*goal), rel=ODE_PUBLISHED)


@pytest.mark.slow
def test_a_chain_hangs_in_its_catenary():
    """COPS's problem: int x sqrt(1 + x'^2) from x(0) = 1 to x(1) = 3 with a length of 4."""
    c = brentq(lambda c: 2 * c * np.sinh(0.5 / c) - np.sqrt(4**2 - 2**2), 0.05, 5, xtol=1e-15)
    lowest = 0.5 - c * np.arctanh(2 / 4)
    offset = 1 - c * np.cosh(lowest / c)
    exact = quad(lambda t: (c * np.cosh((t - lowest) / c) + offset) * np.cosh((t - lowest) / c), 0, 1, epsabs=1e-13)[0]
    plan = solved(
        rate=lambda x, u, p, t: [u[0], ca.sqrt(1 + u[0] ** 2)],  # noqa: ARG005
        start=[1, 0],
        goal=[3, 4],
        effort_limit=FREE_EFFORT,
        duration_s=1.0,
        running_cost=lambda x, u, p, t: x[0] * ca.sqrt(1 + u[0] ** 2),  # noqa: ARG005
        guesses=[StateGuess(state=[[1, 0], [3, 4]], effort=[[-4], [5]])],
    )
    assert plan.objective == pytest.approx(exact, rel=ODE_INTEGRATED)


@pytest.mark.slow
def test_an_aircraft_s_angle_of_attack_is_brought_to_zero_in_the_better_of_two_local_least_times():
    """The F-8 of Garrard and Jordan, |u| <= 0.05236: 3.78086 is the best known, 5.74 a local optimum next to it."""

    def rate(x, u, p, t):  # noqa: ARG001
        a, b, c, w = x[0], x[1], x[2], u[0]
        return [
            -0.877 * a + c - 0.088 * a * c + 0.47 * a**2 - 0.019 * b**2 - a**2 * c + 3.846 * a**3
            - 0.215 * w + 0.28 * a**2 * w + 0.47 * a * w**2 + 0.63 * w**3,
            c,
            -4.208 * a - 0.396 * c - 0.47 * a**2 - 3.564 * a**3
            - 20.967 * w + 6.265 * a**2 * w + 46 * a * w**2 + 61.4 * w**3,
        ]  # fmt: skip

    plan = solved(
        rate=rate,
        start=[0.4655, 0, 0],
        goal=[0, 0, 0],
        effort_limit=[[-0.05236, 0.05236]],
        duration_s=(0.1, 30),
        guesses=[StateGuess(state=[[0.4655, 0, 0], [0, 0, 0]], duration_s=3.0)],
        final_cost=duration,
    )
    assert plan.objective == pytest.approx(3.78086, abs=FIVE_DIGITS)


@pytest.mark.slow
def test_the_shortest_way_round_a_disk_is_two_tangents_and_an_arc():
    distance = np.hypot(2, 0.3)
    arc = np.arctan2(0.3, -2) - np.arctan2(0.3, 2) - 2 * np.arccos(1 / distance)
    plan = solved(
        rate=lambda x, u, p, t: [ca.cos(u[0]), ca.sin(u[0])],  # noqa: ARG005
        start=[-2, 0.3],
        goal=[2, 0.3],
        effort_limit=FREE_EFFORT,
        duration_s=(0.1, 50),
        path=lambda x, u, p, t: x[0] ** 2 + x[1] ** 2,  # noqa: ARG005
        path_limit=[[1, INF]],
        final_cost=duration,
    )
    assert plan.objective == pytest.approx(2 * np.sqrt(distance**2 - 1) + arc, rel=ODE_KINKED)
    motion = plan.trajectory
    squares = np.sum(motion.state_at(motion.dense_times(40)) ** 2, axis=1)
    assert squares.min() >= 1 - LIMIT_SLACK * squares.max()


# Long and stiff, singular, and many-stationed.


@pytest.mark.slow
@pytest.mark.parametrize("T", [25.0, 100.0, 1e3])  # the layers are as long: a thousandth of the last
def test_a_hypersensitive_motion_costs_its_two_boundary_layers(T):
    """Rao & Mease: x' = -x^3 + u, int (x^2 + u^2) / 2 from 1 to 1.5; in and out along H = 0, u = x^3 -+ x sqrt(x^4 + 1)."""

    def layer(x: float) -> float:
        return 0.25 * (x**2 * np.sqrt(x**4 + 1) + np.arcsinh(x**2))

    plan = solved(
        rate=lambda x, u, p, t: [-(x[0] ** 3) + u[0]],  # noqa: ARG005
        start=[1],
        goal=[1.5],
        effort_limit=FREE_EFFORT,
        duration_s=T,
        running_cost=lambda x, u, p, t: (x[0] ** 2 + u[0] ** 2) / 2,  # noqa: ARG005
    )
    assert plan.objective == pytest.approx(layer(1) - 1 / 4 + layer(1.5) + 1.5**4 / 4, rel=ODE_CLOSED_FORM)


@pytest.mark.slow
def test_jacobson_s_singular_problem_costs_its_bang_and_its_arc():
    """int (x1^2 + x2^2) / 2 over 5 s from (0, 1): u = -1, then u = x1 with x2 = -x1 tanh(5 - t)."""

    def bang(t: float) -> tuple[float, float]:
        return t - t**2 / 2, 1 - t

    def off(t: float) -> float:
        return bang(t)[0] * np.sinh(5 - t) + bang(t)[1] * np.cosh(5 - t)

    switch = brentq(off, 1, 1.9, xtol=1e-15)
    x1, x2 = bang(switch)
    first = quad(lambda t: sum(np.square(bang(t))) / 2, 0, switch, epsabs=1e-14)[0]
    rest = quad(
        lambda t: ((x1 * np.cosh(t) + x2 * np.sinh(t)) ** 2 + (x1 * np.sinh(t) + x2 * np.cosh(t)) ** 2) / 2, 0, 5 - switch
    )[0]
    plan = solved(
        rate=double_integrator,
        start=[0, 1],
        goal=[NAN, NAN],
        effort_limit=[[-1, 1]],
        duration_s=5.0,
        running_cost=lambda x, u, p, t: (x[0] ** 2 + x[1] ** 2) / 2,  # noqa: ARG005
    )
    assert plan.objective == pytest.approx(first + rest, rel=ODE_PUBLISHED)
    # The reported cost is that of the motion, kinks between nodes and all.
    assert plan.objective == pytest.approx(plan.certificate.integrated_objective, rel=ODE_INTEGRATED_ROUGHLY)


def test_a_chemist_s_reactor_is_cooled_as_luus_has_it():
    """Luus's stirred tank: 0.133094 is the best known, 0.244 a local optimum."""

    def rate(x, u, p, t):  # noqa: ARG001
        k = (x[1] + 0.5) * ca.exp(25 * x[0] / (x[0] + 2))
        return [-(2 + u[0]) * (x[0] + 0.25) + k, 0.5 - x[1] - k]

    plan = solved(
        rate=rate,
        start=[0.09, 0.09],
        goal=[NAN, NAN],
        effort_limit=FREE_EFFORT,
        duration_s=0.78,
        running_cost=lambda x, u, p, t: x[0] ** 2 + x[1] ** 2 + 0.1 * u[0] ** 2,  # noqa: ARG005
    )
    assert plan.objective == pytest.approx(0.133095, abs=COPS_GLIDER)


@pytest.mark.long
def test_thrusters_are_fired_as_sparingly_as_is_known():
    """The free-flying robot of Sakawa: int of four thrusts, pairs of which never fire together; Betts has 7.9101546."""

    def rate(x, u, p, t):  # noqa: ARG001
        left, right = u[0] - u[1], u[2] - u[3]
        return [x[3], x[4], x[5], (left + right) * ca.cos(x[2]), (left + right) * ca.sin(x[2]), 0.2 * (left - right)]

    plan = solved(
        rate=rate,
        start=[-10, -10, np.pi / 2, 0, 0, 0],
        goal=[0, 0, 0, 0, 0, 0],
        effort_limit=[[0, 1]] * 4,
        path=lambda x, u, p, t: [u[0] + u[1], u[2] + u[3]],  # noqa: ARG005
        path_limit=[[-INF, 1]] * 2,
        duration_s=12.0,
        running_cost=lambda x, u, p, t: ca.sum1(u),  # noqa: ARG005
    )
    assert plan.objective == pytest.approx(7.9101546, rel=ODE_FOUR_DIGITS)


# Limits on path quantities and states, between the nodes too.


@pytest.mark.slow
def test_a_path_limit_that_is_overrun_between_the_nodes_is_tightened():
    """Van der Pol's oscillator above a wave: without tightening no mesh keeps it; 2.871975 by Hermite and Simpson's rule."""
    plan = solved(
        rate=lambda x, u, p, t: [(1 - x[1] ** 2) * x[0] - x[1] + u[0], x[0]],  # noqa: ARG005
        start=[0, 1],
        goal=[NAN, NAN],
        effort_limit=[[-1, 1]],
        duration_s=6.0,
        running_cost=lambda x, u, p, t: ca.sumsqr(x) + u[0] ** 2,  # noqa: ARG005
        path=lambda x, u, p, t: x[0] + 0.3 * ca.sin(t),  # noqa: ARG005
        path_limit=[[-0.3, INF]],
    )
    assert any("tightened" in step.what for step in plan.history)
    t = plan.trajectory.dense_times(40)
    assert np.min(plan.trajectory.state_at(t)[:, 0] + 0.3 * np.sin(t)) >= -0.3 * (1 + LIMIT_SLACK)
    assert plan.objective == pytest.approx(2.871975, rel=FIVE_DIGITS)


@pytest.mark.slow
def test_a_state_s_limit_is_kept_by_the_integrated_motion_too():
    """x''' = u within +-10, |v| <= 0.5, |a| <= 1, 1 from rest to rest: 2.6 s; a speed's polynomial may lie on its limit
    with an acceleration that swings about zero between the nodes, and the motion itself beyond it.
    """
    limit = np.array([[-INF, INF], [-0.5, 0.5], [-1, 1]])
    plan = solved(
        rate=lambda x, u, p, t: [x[1], x[2], u[0]],  # noqa: ARG005
        start=[0, 0, 0],
        goal=[1, 0, 0],
        effort_limit=[[-10, 10]],
        state_limit=limit,
        duration_s=(0.1, 100),
        final_cost=duration,
    )
    motion, state, most = plan.trajectory, np.zeros(3), 0.0
    for k, width in enumerate(np.diff(motion.breaks_s)):
        at = motion.breaks_s[k] + width * np.linspace(0, 1 - 1e-9, 30)
        run = solve_ivp(
            lambda t, y: [y[1], y[2], motion.effort_at([t])[0, 0]], at[[0, -1]], state, t_eval=at, rtol=1e-10, atol=1e-12
        )
        most, state = max(most, np.abs(run.y[1]).max() - 0.5, np.abs(run.y[2]).max() - 1), run.y[:, -1]
    assert most <= OVERRUN_SHARE
    assert plan.objective >= 2.6 * (1 - OVERRUN_SHARE)
    assert plan.objective == pytest.approx(2.6, rel=ODE_STATE_ARCS)
