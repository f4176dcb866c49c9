"""Least times and fuels by `plan_ode` whose switches hide from a mesh, from costates and starts that find them."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq

from linkplan.planner.ode.case import OdeCase
from linkplan.planner.ode.formulation import start_of, straight_guess, units_of
from linkplan.planner.ode.problem import OdeProblem, StateGuess
from linkplan.planner.ode.solve_ocp import OdePlan, plan_ode
from linkplan.planner.ode.switches import Switching, _switch_times, is_affine, switching_of
from linkplan.planner.refinement.case import attempt
from linkplan.planner.transcription.mesh import uniform
from tests.support.ode import FREE_EFFORT, double_integrator, duration, oscillator, solved, squared_effort
from tests.support.tolerances_planner import (
    ODE_CLOSED_FORM,
    ODE_COLLAPSED_ARC,
    ODE_PUBLISHED,
    ODE_SHORT,
    ODE_STATE,
    ODE_SWITCH,
    ROUNDING,
)

# Least time of an oscillator x'' = -x + u with |u| <= 1, from rest at x0 to rest at 0: circles about -1 and 1 in turn.


def half_circles(x0: float) -> list[float]:
    """Return the durations of the arcs from rest at x0 > 0: the first, half circles, the last.

    Under u = -1 the state goes round -1 with radius x0 + 1 until it meets the chain of half circles of radius 1 about 1, 3,
    5, ...: then round 1 and -1 in turn, half a circle each, which takes it from one half circle of the chain to the next.
    """
    if x0 % 2 == 0:
        return [np.pi] * int(x0 // 2)
    centre = 2 * int(x0 // 2) + 1
    x = ((x0 + 1) ** 2 - 1 + centre**2 - 1) / (2 * (1 + centre))
    v = np.sqrt(1 - (x - centre) ** 2)
    return [np.arctan2(v, x + 1), *[np.pi] * (centre // 2), np.pi - np.arctan2(v, x - centre)]


@cache
def settled_oscillator(x0: float) -> OdePlan:
    return solved(
        OdeProblem(
            name="oscillator, least time",
            rate=oscillator,
            start=[x0, 0],
            goal=[0, 0],
            effort_limit=[[-1, 1]],
            duration_s=(0.1, 100),
            final_cost=duration,
        )
    )


@pytest.mark.parametrize("x0", [1.5, 3.0, 5.5, 8.3])
def test_the_half_circles_lead_an_oscillator_to_rest(x0):
    """The oracle itself: its arcs, integrated."""
    arcs, state = half_circles(x0), np.array([x0, 0.0])
    for number, arc in enumerate(arcs):
        u = -1.0 if number % 2 == 0 else 1.0
        c, s = np.cos(arc), np.sin(arc)
        state = np.array([u + (state[0] - u) * c + state[1] * s, state[1] * c - (state[0] - u) * s])
    np.testing.assert_allclose(state, 0.0, atol=ROUNDING)


@pytest.mark.slow
@pytest.mark.parametrize("x0", [0.7, 1.5, 3.0, 5.5, 8.3])
def test_an_oscillator_comes_to_rest_in_the_time_of_its_half_circles(x0):
    assert settled_oscillator(x0).objective == pytest.approx(sum(half_circles(x0)), rel=ODE_SHORT)


@pytest.mark.slow
def test_an_oscillator_an_even_way_out_comes_to_rest_under_one_constant_effort():
    """From x0 = 2 the switching curve is met at once: u = 1 for half a turn, and no mesh has a switch to show."""
    assert settled_oscillator(2.0).objective == pytest.approx(np.pi, rel=ODE_COLLAPSED_ARC)


@pytest.mark.slow
def test_an_arc_shorter_than_an_interval_is_found():
    """From 8.3 the first arc is a hundred and eightieth of the motion, the mesh has forty intervals."""
    arcs, motion = half_circles(8.3), settled_oscillator(8.3).trajectory
    assert arcs[0] < motion.duration_s / 100
    time = motion.dense_times(50)
    switches = time[1:][np.diff(np.sign(motion.effort_at(time)[:, 0])) != 0]
    np.testing.assert_allclose(switches, np.cumsum(arcs)[:-1], atol=ODE_SWITCH)


def test_switching_functions_are_the_costates_of_the_closed_form():
    """x'' = u from rest to rest at 1 in least time T = 2: the costate of v is t - 1, as 1 + lambda_v u = 0 at the ends."""
    problem = OdeProblem(
        name="double integrator",
        rate=double_integrator,
        start=[0, 0],
        goal=[1, 0],
        effort_limit=[[-1, 1]],
        duration_s=(0.1, 10),
        final_cost=duration,
    )
    assert is_affine(problem)
    guess = straight_guess(problem)
    case = OdeCase(problem, problem, units_of(problem, guess))
    found = attempt(case, start_of(guess, case.units), uniform(40), np.array([guess.duration_s]), "")
    switching = switching_of(problem, found.motion, found.solution)
    np.testing.assert_allclose(switching.value[:, :, 0], switching.time_s - 1.0, atol=ODE_STATE)


# Bang-bang.


@pytest.mark.slow
def test_three_integrators_in_a_row_take_the_cube_root_of_32_distances():
    plan = solved(
        OdeProblem(
            name="triple integrator",
            rate=lambda x, u, p, t: [x[1], x[2], u[0]],  # noqa: ARG005
            start=[0, 0, 0],
            goal=[1, 0, 0],
            effort_limit=[[-1, 1]],
            duration_s=(0.1, 100),
            final_cost=duration,
        )
    )
    assert plan.objective == pytest.approx(32 ** (1 / 3), rel=ODE_CLOSED_FORM)


@pytest.mark.slow
@pytest.mark.parametrize("drag", ["linear", "quadratic"])
def test_a_cart_with_drag_takes_the_time_of_its_two_arcs(drag):
    def times(push: float) -> tuple[float, float]:
        """Return the distance covered and the time taken when pushing for so long, then braking to rest."""
        if drag == "linear":  # v' = u - v
            v = 1 - np.exp(-push)
            return push - np.log(1 + v), push + np.log(1 + v)
        v = np.tanh(push)  # v' = u - v |v|
        return np.log(np.cosh(push)) + 0.5 * np.log(1 + v**2), push + np.arctan(v)

    push = brentq(lambda push: times(push)[0] - 2.0, 1e-6, 50, xtol=1e-15)
    plan = solved(
        OdeProblem(
            name=f"{drag} drag",
            rate=lambda x, u, p, t: [x[1], u[0] - x[1] * (1 if drag == "linear" else ca.fabs(x[1]))],  # noqa: ARG005
            start=[0, 0],
            goal=[2, 0],
            effort_limit=[[-1, 1]],
            duration_s=(0.1, 100),
            final_cost=duration,
        )
    )
    assert plan.objective == pytest.approx(times(push)[1], rel=ODE_SHORT)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "rate", "start", "goal", "published"),
    [
        ("Van der Pol", lambda x, u: [x[1], -x[0] - (x[0] ** 2 - 1) * x[1] + u[0]], [-0.4, 0.6], [0.6, 0.4], 1.25407473),
        (
            "Rayleigh",
            lambda x, u: [x[1], -x[0] + x[1] * (1.4 - 0.14 * x[1] ** 2) + 4 * u[0]],
            [-5, -5],
            [0, 0],
            3.66817339,
        ),
    ],
)
def test_oscillators_are_brought_where_they_are_asked_in_the_published_least_times(name, rate, start, goal, published):
    """Kaya and Noakes, J. Optim. Theory Appl. 117 (2003); Maurer and Augustin."""
    plan = solved(
        OdeProblem(
            name=name,
            rate=lambda x, u, p, t: rate(x, u),  # noqa: ARG005
            start=start,
            goal=goal,
            effort_limit=[[-1, 1]],
            duration_s=(0.1, 100),
            final_cost=duration,
        )
    )
    assert plan.objective == pytest.approx(published, rel=ODE_PUBLISHED)


@pytest.mark.slow
def test_a_lander_falls_and_brakes_at_the_last_instant():
    """Meditch: h'' = -1.5 + u, 0 <= u <= 3, from 10 at -2 to rest, least int u."""
    fall = brentq(lambda t: (-2 - 1.5 * t) ** 2 - 2 * 1.5 * (10 - 2 * t - 0.75 * t**2), 0, 2.5, xtol=1e-15)
    plan = solved(
        OdeProblem(
            name="lander",
            rate=lambda x, u, p, t: [x[1], -1.5 + u[0]],  # noqa: ARG005
            start=[10, -2],
            goal=[0, 0],
            effort_limit=[[0, 3]],
            duration_s=(0.1, 100),
            running_cost=lambda x, u, p, t: u[0],  # noqa: ARG005
        )
    )
    assert plan.objective == pytest.approx(3 * (2 + 1.5 * fall) / 1.5, rel=ODE_CLOSED_FORM)


@pytest.mark.slow
def test_least_fuel_pushes_coasts_and_brakes():
    """x'' = u - w within [0, 1], 1 in 3 s, least int u + w: two pushes of tau with tau (3 - tau) = 1."""
    plan = solved(
        OdeProblem(
            name="least fuel",
            rate=lambda x, u, p, t: [x[1], u[0] - u[1]],  # noqa: ARG005
            start=[0, 0],
            goal=[1, 0],
            effort_limit=[[0, 1]] * 2,
            duration_s=3.0,
            running_cost=lambda x, u, p, t: u[0] + u[1],  # noqa: ARG005
        )
    )
    assert plan.objective == pytest.approx(3 - np.sqrt(5), rel=ODE_CLOSED_FORM)


# Starts.


@pytest.mark.slow
def test_a_free_duration_that_the_first_start_misjudges_is_found_from_another():
    plan = settled_oscillator(8.3)
    assert not plan.history[0].converged
    assert plan.status == "optimal"


def test_a_user_s_own_guess_is_begun_from_and_nothing_else():
    plan = plan_ode(
        OdeProblem(
            name="double integrator",
            rate=double_integrator,
            start=[0, 0],
            goal=[1, 0],
            effort_limit=[[-1, 1]],
            duration_s=(0.1, 10),
            final_cost=duration,
            guesses=[StateGuess(state=[[0, 0], [0.5, 1], [1, 0]], duration_s=2.5)],
        )
    )
    assert [step.what for step in plan.history if step.what.startswith(("first", "start"))] == ["first solve"]


def test_a_duration_that_is_given_is_begun_from_once():
    plan = plan_ode(
        OdeProblem(
            name="double integrator",
            rate=double_integrator,
            start=[0, 0],
            goal=[1, 0],
            effort_limit=FREE_EFFORT,
            duration_s=1.0,
            running_cost=squared_effort,
        )
    )
    assert [step.what for step in plan.history if step.what.startswith(("first", "start"))] == ["first solve"]


def test_switch_times_are_where_switching_functions_cross_zero():
    """Straight lines fall through zero at 0.37 s and 1.61 s; a third keeps its sign."""
    time = np.array([np.linspace(0.0, 1.0, 5), np.linspace(1.0, 2.0, 5)])
    value = np.stack([0.37 - time, 5.0 * (1.61 - time), 1.0 + time], axis=2)
    assert _switch_times(Switching(time_s=time, value=value)) == pytest.approx([0.37, 1.61], rel=1e-12)
