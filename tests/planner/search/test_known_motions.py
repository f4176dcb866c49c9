"""Answers do not contradict one another: a certified motion of less time forbids "infeasible", where it can wait at rest."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search.planning import plan_motion
from tests.bench.contradictions import rotary_answer, weak_answer, weak_case


@pytest.mark.slow
def test_a_least_effort_that_begins_on_the_smooth_path_costs_no_more_than_a_shorter_one_that_swings():
    """The smooth path leads straight to the goal at 0.2352; beyond it and back, one of 1.002 least times costs 0.2303."""
    assert weak_answer(77, 69, factors=(1.002, 1.01))["wrong"] == []


@pytest.mark.long
def test_a_quick_turn_whose_higher_degree_is_not_solved_is_refined_by_halving():
    """A turn of a four-bar in 0.011 s, at 570 rad/s: the scheme of degree 7 is not solved on 40 intervals."""
    assert rotary_answer(4078, 11)["wrong"] == []


# A rod on a damped hinge: its weight takes most of the motor's torque once a turn, and helps as much half a turn later.
ROTOR = """<mujoco><option gravity="0 0 -9.81"/><worldbody><body name="rod"><joint name="J" axis="0 1 0" damping="0.05"/>
<inertial pos="0 0 -0.5" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>
<actuator><motor name="m" joint="J" ctrlrange="-5 5"/></actuator></mujoco>"""


def quickest_turn_s() -> float:
    """Return the period of the turn under full torque: J w dw/dx = 5 - 0.05 w - m g l sin x, w(2 pi) = w(0)."""

    def turn(speed: float) -> np.ndarray:
        def rate(x: float, y: np.ndarray) -> list[float]:
            return [(5.0 - 0.05 * y[0] - 0.5 * 9.81 * np.sin(x)) / (0.26 * y[0]), 1.0 / y[0]]

        return solve_ivp(rate, (0.0, 2 * np.pi), [speed, 0.0], rtol=1e-11, atol=1e-12).y[:, -1]

    return float(turn(brentq(lambda speed: turn(speed)[0] - speed, 60.0, 200.0, xtol=1e-10))[1])


@pytest.mark.slow
def test_the_quickest_turn_is_that_of_full_torque_also_where_a_slower_turn_is_a_local_optimum():
    motion = {"kind": "periodic", "turns": {"J": 1}, "duration_s": "free"}
    tables = {"mechanism": {"model": ROTOR}, "motion": motion, "objective": {"minimize": "time"}}
    plan = plan_motion(Problem.from_tables("rotor", tables))
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(quickest_turn_s(), rel=1e-6)


@pytest.mark.slow
def test_a_turn_that_could_be_quicker_takes_the_least_duration_that_is_allowed():
    motion = {"kind": "periodic", "turns": {"J": 1}, "duration_s": "free", "min_duration_s": 0.1}
    tables = {"mechanism": {"model": ROTOR}, "motion": motion, "objective": {"minimize": "time"}}
    plan = plan_motion(Problem.from_tables("rotor", tables))
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(0.1, rel=1e-8)


@pytest.mark.slow
def test_a_direct_reach_that_the_phase_plane_knows_is_found_where_the_smooth_path_leads_to_a_slower_one():
    fourbar, start, goal, limit = weak_case(1, 11)
    ends = {"start_deg": {"O": np.degrees(start)}, "goal_deg": {"O": np.degrees(goal)}}
    motion = {"kind": "reach", **ends, "duration_s": "free"}
    tables = {"mechanism": {"model": fourbar.mjcf(start, limit=limit)}, "motion": motion, "objective": {"minimize": "time"}}
    plan = plan_motion(Problem.from_tables("weak", tables))
    assert plan.objective == pytest.approx(fourbar.minimum_time(start, goal, -limit, limit), rel=1e-6)


@pytest.mark.slow
def test_a_turn_is_no_slower_than_under_constant_full_effort_or_at_constant_speed():
    assert rotary_answer(1, 4)["wrong"] == []


@pytest.mark.slow
def test_guesses_along_which_the_loops_open_are_left_out_and_others_show_the_effort_that_is_lacking():
    ends = {"start_deg": {"O1": 10.0, "O2": 170.0}, "goal_deg": {"O1": 100.0, "O2": 80.0}}
    motion = {"kind": "reach", **ends, "duration_s": 1.0}
    tables = {"mechanism": {"model": "five-bar"}, "motion": motion, "objective": {"minimize": "effort"}}
    plan = plan_motion(Problem.from_tables("far", tables | {"mesh": {"intervals": 6}}))
    assert plan.status == "infeasible", plan.message
    assert "N.m beyond its limit of 1.4" in plan.message


@pytest.mark.parametrize(
    ("name", "words"), [("knee-sprint", "time-optimal motion"), ("knee-reach", "locally effort-optimal motion")]
)
def test_only_what_the_phase_plane_proves_is_called_more_than_locally_optimal(name, words):
    assert plan_motion(load_problem(name)).message.startswith(words)
