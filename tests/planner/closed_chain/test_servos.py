"""Servos as bounded efforts: their ctrl ranges limit the motion, and are named where they forbid it."""

import pytest

from tests.support.bodies import body_plan

SERVO = """<mujoco><option gravity="0 0 -9.81"/><worldbody><body name="rod"><joint name="J" axis="0 1 0"/>
<inertial pos="0 0 -0.5" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>
<actuator><position name="s" joint="J" kp="100" ctrlrange="-{reach} {reach}" forcerange="-20 20"/></actuator></mujoco>"""
REACH = 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 60.0 }\nduration_s = 0.8\n'


def test_a_servo_with_room_is_planned():
    plan = body_plan(SERVO.format(reach=2.0), REACH)
    assert plan.status == "optimal", plan.message


@pytest.mark.slow
def test_a_servo_that_would_need_more_ctrl_than_it_has_is_named_with_its_range():
    plan = body_plan(SERVO.format(reach=0.5), REACH)
    assert plan.status == "infeasible"
    assert "the ctrl of s would have to come to" in plan.message
    assert "beyond its limit of 0.5" in plan.message


@pytest.mark.slow
def test_a_servos_ctrl_stays_in_its_range_where_the_motion_needs_all_of_it():
    plan = body_plan(SERVO.format(reach=0.9), REACH).require()
    (ctrl,) = (margin for margin in plan.certificate.margins if margin.what == "control")
    assert ctrl.kept
    assert ctrl.value == pytest.approx(0.9, rel=1e-3)
