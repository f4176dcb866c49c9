"""Servos as bounded efforts: their ctrl ranges limit the motion, and are named where they forbid it."""

import numpy as np
import pytest

from tests.support.bodies import body_plan

SERVO = """<mujoco><option gravity="0 0 -9.81"/><worldbody><body name="rod"><joint name="J" axis="0 1 0"/>
<inertial pos="0 0 -0.5" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>
<actuator><position name="s" joint="J" kp="100" ctrlrange="-{reach} {reach}" forcerange="-20 20"/></actuator></mujoco>"""
# An effort that is to be the clamp of a servo's force, relative: a motion enters there between two nodes.
AT_CLAMP = 1e-4
REACH = 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 60.0 }\nduration_s = 0.8\n'


@pytest.mark.slow
def test_a_servo_that_pulls_back_with_all_its_force_at_the_goal_is_planned_with():
    """At 60 deg any ctrl to 0.5 pulls back with the 20 N.m at which its forcerange ends: so it slows down and arrives."""
    plan = body_plan(SERVO.format(reach=0.5), REACH.replace("0.8", "0.5"))
    assert plan.status == "optimal", plan.message
    end = plan.trajectory.duration_s
    beyond = plan.trajectory.position_at(np.linspace(0, end, 400))[:, 0] > 0.71
    assert np.any(beyond)
    assert np.abs(plan.trajectory.effort_at(np.linspace(0, end, 400))[beyond, 0] + 20).max() < 20 * AT_CLAMP


def test_a_servo_that_cannot_hold_back_gently_at_its_goal_is_said_at_once():
    """At 60 deg a ctrl of 0.5 asks for at least 100 (1.0472 - 0.5) N.m, of which 20 are given; the problem allows 10."""
    plan = body_plan(SERVO.format(reach=0.5), REACH, "limits.effort.s=[-10,10]")
    assert plan.status == "infeasible"
    assert plan.history == ()
    assert f"s on joint J would need a ctrl of {np.pi / 3 - 0.1:.4g} at the goal" in plan.message
    assert "its ctrlrange is -0.5 to 0.5" in plan.message


def test_a_joint_servos_plan_stays_within_the_ctrl_that_it_has():
    """ctrl = q + u / kp, in closed form: up to its end it is used, and no further."""

    def ctrl(plan) -> np.ndarray:
        time = plan.trajectory.dense_times(16)
        return plan.trajectory.position_at(time)[:, 0] + plan.trajectory.effort_at(time)[:, 0] / 100

    hurried = REACH.replace("0.8", "0.3")
    wide, tight = (body_plan(SERVO.format(reach=reach), hurried) for reach in (2.0, 0.9))
    assert (wide.status, tight.status) == ("optimal", "optimal"), tight.message
    assert np.abs(ctrl(wide)).max() > 0.92  # the range is in the way
    assert 0.9 - 1e-3 < np.abs(ctrl(tight)).max() < 0.9 + 1e-6
    assert tight.objective > wide.objective * 1.005


@pytest.mark.slow
def test_a_ctrl_range_that_forbids_the_motion_is_named():
    """A softer servo, u <= 22 (0.9 - q): its forcerange alone would do for 0.2248 s, its ctrl takes 0.2363 s."""
    softer = SERVO.replace('kp="100"', 'kp="22"').format(reach=0.9)
    plan = body_plan(softer, REACH.replace("0.8", "0.23"), "mesh.intervals=10")
    assert plan.status == "infeasible"
    assert "the ctrl of s would have to come to" in plan.message
    assert "beyond its limit of 0.9" in plan.message
    assert plan.details["shortest_duration_s"] > 0.23
