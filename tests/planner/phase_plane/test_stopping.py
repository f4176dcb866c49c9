"""Starts and goals at speed: where full effort stops them, and the sentence where a range ends before."""

import numpy as np
import pytest

from linkplan.planner.phase_plane.bang_bang_motions import least_time_guess
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.search.presolve import no_way_to_stop

# A mass of 2 kg on a rail, pushed by at most 6 N: it stops from 0.3 m/s within 0.015 m.
CART = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="x" type="slide" axis="1 0 0" range="{low} {high}"/>
<inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/></body></worldbody>
<actuator><motor name="push" joint="x" ctrlrange="-6 6"/></actuator></mujoco>"""
ACCELERATION, SPEED = 3.0, 0.3
STOP = SPEED**2 / (2 * ACCELERATION)


def reach(start: float, goal: float, *, low: float = -2.0, high: float = 2.0, minimize: str = "time", **motion):
    ends = {"start_m": {"x": start}, "goal_m": {"x": goal}, "duration_s": "free"}
    return Problem.from_tables(
        "cart",
        {
            "mechanism": {"model": CART.format(low=low, high=high)},
            "motion": {"kind": "reach"} | ends | motion,
            "objective": {"minimize": minimize},
        },
    )


@pytest.mark.parametrize("end", ["start", "goal"])
def test_a_start_or_goal_passed_away_from_the_other_takes_the_way_that_full_effort_takes(end):
    """It turns where full effort stops it, or takes a run up."""
    problem = reach(0.0, -1.0, **{f"{end}_speed_m_s": {"x": SPEED}})
    least = SPEED / ACCELERATION + 2 * np.sqrt((1.0 + STOP) / ACCELERATION)
    guess = least_time_guess(problem, problem.start_pose())
    assert guess is not None
    assert guess.duration_s == pytest.approx(least, rel=1e-3 if end == "start" else 2e-3)
    assert plan_motion(problem).objective == pytest.approx(least, rel=1e-6)


@pytest.mark.parametrize("beyond", [0.0, 0.25, 1.0])
def test_a_start_as_fast_as_it_may_be_brakes_into_the_goal_and_a_faster_one_comes_back_from_beyond(beyond):
    speed = 2.0
    stop = speed**2 / (2 * ACCELERATION)
    problem = reach(0.0, stop - beyond, start_speed_m_s={"x": speed})
    guess = least_time_guess(problem, problem.start_pose())
    assert guess is not None
    assert guess.duration_s == pytest.approx(speed / ACCELERATION + 2 * np.sqrt(beyond / ACCELERATION), rel=2e-3)
    assert guess.velocity(np.zeros(1))[0, 0] == pytest.approx(speed, rel=1e-3)


@pytest.mark.parametrize(("minimize", "duration"), [("time", "free"), ("effort", 2.0)])
def test_a_range_that_ends_before_the_stop_is_infeasible_and_the_sentence_names_it(minimize, duration):
    asked = {"minimize": minimize, "duration_s": duration, "start_speed_m_s": {"x": SPEED}}
    plan = plan_motion(reach(0.0, -1.0, high=0.97 * STOP, **asked))
    assert plan.status == "infeasible"
    assert "no effort within its limits stops the 0.3 m/s of joint x at the start" in plan.message
    assert plan.trajectory is None


def test_a_range_that_ends_just_behind_the_stop_is_not_refused():
    assert no_way_to_stop(reach(0.0, -1.0, high=1.001 * STOP, start_speed_m_s={"x": SPEED})) is None


def test_a_goal_speed_that_the_range_leaves_no_run_up_for_is_infeasible():
    plan = plan_motion(reach(0.5, -1.0, low=-1.0 - 0.97 * STOP, goal_speed_m_s={"x": SPEED}))
    assert plan.status == "infeasible"
    assert "gathers the 0.3 m/s of joint x at the goal" in plan.message


def test_a_goal_that_may_be_passed_at_speed_needs_no_stop_behind_it():
    quick = {"start_speed_m_s": {"x": SPEED}, "goal_speed_m_s": {"x": SPEED}}
    assert no_way_to_stop(reach(0.0, 0.5, high=0.5 + 0.5 * STOP, **quick)) is None
