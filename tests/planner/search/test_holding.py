"""Poses that are held: static equilibrium by constant efforts, at stable and unstable poses, and what forbids it."""

import numpy as np
import pytest

import linkplan
from linkplan.models.errors import ProblemError
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion

G, MASS_KG, ARM_M = 9.81, 0.5, 0.4
STICK_ON_SLIDER = f"""
<mujoco><worldbody><body name="slider"><joint name="x" type="slide" axis="1 0 0"/>
  <inertial mass="2" pos="0 0 0" diaginertia="0.01 0.01 0.01"/>
  <body name="stick"><joint name="q" axis="0 1 0"/>
    <inertial mass="{MASS_KG}" pos="0 0 -{ARM_M}" diaginertia="0.01 0.01 0.001"/></body></body></worldbody>
<actuator><motor name="f" joint="x" ctrlrange="-30 30"/></actuator></mujoco>
"""
# An arm that stands out level, with its weight of m g l = 1.962 N.m.
ARM = f"""
<mujoco><worldbody><body name="arm"><joint name="q" axis="0 1 0"/>
  <inertial mass="{MASS_KG}" pos="{ARM_M} 0 0" diaginertia="0.01 0.01 0.01"/></body></worldbody>
<actuator>{{}}</actuator></mujoco>
"""
ONE = ARM.format('<motor name="m" joint="q" ctrlrange="-5 5"/>')
TWO = ARM.format('<motor name="weak" joint="q" ctrlrange="-0.5 0.5"/><motor name="m" joint="q" ctrlrange="-5 5"/>')
WEIGHT = MASS_KG * G * ARM_M


@pytest.mark.parametrize("duration_s", [2.0, 120.0])
def test_a_stick_that_stands_on_a_slider_is_held_at_rest_by_no_effort(duration_s):
    plan = plan_motion(Problem.hold(STICK_ON_SLIDER, start_m={"x": 0.0}, start_deg={"q": 180.0}, duration_s=duration_s))
    assert plan.status == "optimal", plan.message
    assert plan.certificate.passed
    assert plan.objective == pytest.approx(0.0, abs=1e-12)
    assert plan.trajectory.duration_s == pytest.approx(duration_s, rel=1e-12)
    np.testing.assert_array_equal(plan.trajectory.velocity, 0.0)


@pytest.mark.parametrize("angle_deg", [0.0, 180.0])
def test_a_reach_in_equilibrium_whose_goal_is_its_start_is_answered_by_a_rest_that_costs_nothing(angle_deg):
    ends = {"start_m": {"x": 0.0}, "start_deg": {"q": angle_deg}, "goal_m": {"x": 0.0}, "goal_deg": {"q": angle_deg}}
    plan = plan_motion(Problem.reach(STICK_ON_SLIDER, duration_s=2.0, **ends))
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(0.0, abs=1e-9)


def test_a_level_arm_is_held_by_its_weight_and_that_is_proved():
    plan = plan_motion(Problem.hold(ONE, start_deg={"q": 0.0}, duration_s=3.0))
    assert plan.status == "optimal", plan.message
    np.testing.assert_allclose(plan.trajectory.effort, -WEIGHT, rtol=1e-12)
    assert plan.objective == pytest.approx(3.0 * WEIGHT**2, rel=1e-12)
    assert plan.prove().verdict == "proved"


def test_the_actuator_that_cannot_hold_a_pose_is_named_with_its_need_and_its_limit():
    problem = Problem.hold(ONE, start_deg={"q": 0.0}, duration_s=1.0, limits={"effort": {"m": [-1.5, 1.5]}})
    plan = plan_motion(problem)
    assert plan.status == "infeasible"
    for said in ("m on joint q", "-1.962 N.m", "0.462 N.m beyond its limit of -1.5"):
        assert said in plan.message, plan.message


def test_a_pose_that_nothing_drives_out_of_equilibrium_names_the_joint_and_its_effort():
    plan = plan_motion(Problem.hold(STICK_ON_SLIDER, start_m={"x": 0.0}, start_deg={"q": 90.0}, duration_s=1.0))
    assert plan.status == "infeasible"
    assert "no actuator gives" in plan.message
    assert f"{WEIGHT:.4g} N.m on joint q" in plan.message


def test_two_actuators_hold_by_the_least_efforts_within_the_limits_of_each():
    plan = plan_motion(Problem.hold(TWO, start_deg={"q": 0.0}, duration_s=1.0))
    assert plan.status == "optimal", plan.message
    np.testing.assert_allclose(plan.trajectory.effort[0, 0], [-0.5, 0.5 - WEIGHT], rtol=1e-9)  # half each is too much


def test_where_a_rest_costs_effort_a_reach_to_its_start_costs_no_more():
    ends = {"start_deg": {"q": 0.0}, "goal_deg": {"q": 0.0}, "duration_s": 2.0}
    rest = plan_motion(Problem.hold(ONE, start_deg={"q": 0.0}, duration_s=2.0))
    plan = plan_motion(Problem.reach(ONE, **ends))
    assert plan.passed, plan.message
    assert plan.objective <= (1 + 1e-4) * rest.objective


def test_a_linear_tracker_keeps_a_stick_standing_as_modelled_and_with_a_mismatch():
    plan = linkplan.plan(Problem.hold(STICK_ON_SLIDER, start_m={"x": 0.0}, start_deg={"q": 180.0}, duration_s=4.0))
    assert linkplan.compare(plan, ["lqr"]).stable


@pytest.mark.parametrize(
    ("changes", "said"),
    [({"duration_s": None}, "needs a motion.duration_s in seconds"), ({"start_deg": None}, "needs a start")],
)
def test_a_hold_without_a_start_or_a_duration_is_refused(changes, said):
    given = {"start_deg": {"q": 0.0}, "duration_s": 1.0} | changes
    with pytest.raises(ProblemError, match=said):
        Problem.hold(ONE, **given)


def test_a_hold_that_is_asked_to_move_is_refused():
    tables = {"motion": {"kind": "hold", "start_deg": {"q": 0.0}, "goal_deg": {"q": 10.0}, "duration_s": 1.0}}
    with pytest.raises(ProblemError, match=r"motion.goal_deg asks for a motion; motion.kind 'hold' stays at its start"):
        Problem.from_tables("hold", tables, mechanism=linkplan.load_mechanism(ONE))
