"""Known optima by `plan_ode` at its default settings, and the motions that have them."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from linkplan.planner.ode.case import case_of, guesses_of
from linkplan.planner.ode.certificate import LIMIT_SLACK, OVERRUN_SHARE
from linkplan.planner.ode.plan import OdePlan, known_digits, plan_ode, plan_of
from linkplan.planner.ode.problem import OdeProblem, StateGuess
from linkplan.planner.refinement.case import attempt
from linkplan.planner.refinement.decision import refine
from linkplan.planner.transcription.mesh import uniform
from tests.support.ode import FREE_EFFORT, INF, bryson_denham, duration, solved, squared_effort
from tests.support.optima import ARCS, OPTIMA, G, cycloid, optimum
from tests.support.tolerances_planner import ODE_INTEGRATED_ROUGHLY, ODE_STATE, ODE_STATE_ARCS, ODE_SWITCH

MARKS = {"little": [], "slow": [pytest.mark.slow], "long": [pytest.mark.long]}


def printed_objective(plan: OdePlan) -> tuple[float, float]:
    """Return the objective that a plan prints, and half the unit of its last digit."""
    text = re.match(r"optimum (\S+) in", plan.message)[1]
    return float(text), 0.5 * 10.0 ** -len(text.partition(".")[2])


@pytest.mark.parametrize("name", [pytest.param(name, marks=MARKS[known.takes]) for name, known in OPTIMA.items()])
def test_an_optimum_is_the_known_one_and_its_error_and_digits_are_as_the_plan_says(name):
    plan, known = optimum(name), OPTIMA[name]
    assert plan.objective == pytest.approx(known.value, rel=known.within, abs=known.within if known.value == 0 else 0)
    error = plan.objective_error + known.within * max(abs(known.value), plan.objective_error)
    value, half = printed_objective(plan)
    assert abs(plan.objective - known.value) <= error
    assert plan.objective_error <= 1e-3 * max(1.0, abs(known.value))
    assert abs(value - known.value) <= error + half
    assert f"the estimated error of the objective is {plan.objective_error:.1g}" in plan.message
    assert plan.objective == pytest.approx(plan.certificate.integrated_objective, rel=ODE_INTEGRATED_ROUGHLY, abs=1e-8)
    assert plan.certificate.integration_error <= plan.problem.tolerance


@pytest.mark.parametrize(
    ("value", "error", "printed"),
    [
        (19.431782, 4e-4, "19.432"),
        (19.431782, 6e-4, "19.43"),
        (-34.14118428, 3e-9, "-34.14118428"),
        (4.000000077, 5e-7, "4"),
        (4.000123, 5e-7, "4.000123"),
        (123456.0, 40.0, "1.235e+05"),
        (57.9, 9.0, "6e+01"),
        (1e-9, 1e-8, "0"),
        (0.0, 0.0, "0"),
        (1 / 3, 0.0, "0.3333333333"),
        (1 / 3, INF, "0.333"),
    ],
)
def test_digits_are_printed_as_far_as_the_error_leaves_them(value, error, printed):
    assert known_digits(value, error) == printed


def test_a_lever_that_grows_with_time_is_pushed_in_proportion_to_it():
    motion = optimum("lever that grows with time").trajectory
    time = motion.dense_times()
    np.testing.assert_allclose(motion.effort_at(time)[:, 0], 3 * 2 / 1.5**3 * time, atol=ODE_STATE)


@pytest.mark.slow
def test_the_brachistochrone_is_the_cycloid():
    motion = optimum("brachistochrone").trajectory
    time, (radius, last) = motion.dense_times(), cycloid()
    assert motion.duration_s == pytest.approx(last * np.sqrt(radius / G))
    angle = time * np.sqrt(G / radius)
    path = radius * np.column_stack([angle - np.sin(angle), 1 - np.cos(angle)])
    np.testing.assert_allclose(motion.state_at(time)[:, :2], path, atol=ODE_STATE)


@pytest.mark.slow
def test_an_oscillator_switches_every_half_period():
    motion = optimum("oscillator to rest").trajectory
    time = motion.dense_times(4)
    switches = time[np.flatnonzero(np.diff(np.sign(motion.effort_at(time)[:, 0])))]
    np.testing.assert_allclose(switches, np.cumsum(ARCS)[:-1], atol=ODE_SWITCH)


@pytest.mark.slow
def test_a_heading_turns_within_an_interval_by_what_it_may_turn_in_that_time():
    motion = optimum("Zermelo's boat").trajectory
    turn = np.ptp(motion.effort, axis=0)[:, 0]
    assert np.all(turn <= np.diff(motion.breaks_s) + ODE_STATE)


@pytest.mark.slow
def test_a_path_limit_that_is_overrun_between_the_nodes_is_tightened():
    """Without tightening no mesh keeps it."""
    plan = optimum("van der Pol above a wave")
    assert any("tightened" in step.what for step in plan.history)
    t = plan.trajectory.dense_times(40)
    assert np.min(plan.trajectory.state_at(t)[:, 0] + 0.3 * np.sin(t)) >= -0.3 * (1 + LIMIT_SLACK)


@pytest.mark.slow
def test_a_state_s_limit_is_kept_by_the_integrated_motion_too():
    """x''' = u within +-10, |v| <= 0.5, |a| <= 1, 1 from rest to rest: 2.6 s; a speed's polynomial may lie on its limit
    with an acceleration that swings about zero between the nodes, and the motion itself beyond it.
    """
    plan = solved(
        rate=lambda x, u, p, t: [x[1], x[2], u[0]], start=[0, 0, 0], goal=[1, 0, 0], effort_limit=[[-10, 10]],  # noqa: ARG005
        state_limit=[[-INF, INF], [-0.5, 0.5], [-1, 1]], duration_s=(0.1, 100), final_cost=duration,
    )  # fmt: skip
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


def test_the_straight_line_is_a_start_beside_guesses_that_lead_nowhere():
    problem = OdeProblem(
        name="1 / x",
        rate=lambda x, u, p, t: [u[0] / x[0]],  # noqa: ARG005
        start=[1],
        goal=[2],
        effort_limit=FREE_EFFORT,
        duration_s=1.0,
        running_cost=squared_effort,
        guesses=[StateGuess(state=[[0.0], [0.0]])],  # there the rate is not finite
    )
    assert plan_ode(problem).objective == pytest.approx(1.5**2, rel=1e-6)  # (x^2 / 2)' = u


@pytest.mark.parametrize(
    ("change", "beginning"),
    [
        (INF, "optimum 4.44 in 1 s; the error of the objective is not known"),
        (4e-3, "optimum 4 in 1 s; the estimated error of the objective is 0.2"),
        (
            6e-3,
            "feasible: the best certified motion, 4 in 1 s, satisfies every limit, but its objective is known to no better",
        ),
    ],
)
def test_the_change_from_the_last_mesh_tells_how_well_an_objective_is_known(change, beginning):
    """The estimated error is ten times the change; with more than 5 %, the motion may be that of another optimum."""
    problem = bryson_denham(0.1, None)
    guess = guesses_of(problem)[0]
    case = case_of(problem, guess)
    found = attempt(case, case.start_from(guess), uniform(40), np.array([1.0]), "first solve")
    plan = plan_of(problem, replace(refine(case, found), objective_error=change))
    assert plan.message.startswith(beginning)
    assert plan.status == ("feasible" if beginning.startswith("feasible") else "optimal")
    assert (plan.objective_error is None) == (change == INF)
