"""Servos as bounded efforts: their ctrl ranges limit the motion, and are named where they forbid it."""

import numpy as np
import pytest

from tests.support.bodies import body_plan

SERVO = """<mujoco><option gravity="0 0 -9.81"/><worldbody><body name="rod"><joint name="J" axis="0 1 0"/>
<inertial pos="0 0 -0.5" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>
<actuator><position name="s" joint="J" kp="100" ctrlrange="-{reach} {reach}" forcerange="-20 20"/></actuator></mujoco>"""
REACH = 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 60.0 }\nduration_s = 0.8\n'


def test_a_servo_with_room_is_planned():
    plan = body_plan(SERVO.format(reach=2.0), REACH)
    assert plan.status == "optimal", plan.message


def test_a_servo_that_cannot_hold_back_at_its_goal_is_said_at_once():
    """At 60 deg a ctrl of 0.5 pulls back with at least 100 (1.0472 - 0.5) N.m; its forcerange ends at 20."""
    plan = body_plan(SERVO.format(reach=0.5), REACH)
    assert plan.status == "infeasible"
    assert plan.history == ()
    assert f"s on joint J would need a ctrl of {np.pi / 3 - 0.2:.4g} at the goal" in plan.message
    assert "its ctrlrange of -0.5 to 0.5" in plan.message


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
    plan = body_plan(softer, REACH.replace("0.8", "0.23"))
    assert plan.status == "infeasible"
    assert "the ctrl of s would have to come to" in plan.message
    assert "beyond its limit of 0.9" in plan.message
    assert plan.details["shortest_duration_s"] > 0.23
