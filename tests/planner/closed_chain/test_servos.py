"""Servos as bounded efforts: what their ctrl cannot give is said at once, and no finer mesh is tried for it."""

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


@pytest.mark.slow
def test_a_servo_that_would_need_more_ctrl_than_it_has_fails_on_the_first_mesh():
    plan = body_plan(SERVO.format(reach=0.9), REACH)
    assert plan.status == "failed"
    assert "s would need a ctrl" in plan.message
    assert len(plan.history) == 1
    assert plan.history[0].intervals == 40


def test_a_joint_servos_plan_stays_within_the_ctrl_that_it_has():
    """ctrl = q + u / kp, in closed form: up to its end it is used, and no further."""

    def ctrl(plan) -> np.ndarray:
        time = plan.trajectory.dense_times(16)
        return plan.trajectory.position_at(time)[:, 0] + plan.trajectory.effort_at(time)[:, 0] / 100

    hurried = REACH.replace("0.8", "0.45")
    wide, tight = (body_plan(SERVO.format(reach=reach), hurried) for reach in (2.0, 1.15))
    assert (wide.status, tight.status) == ("optimal", "optimal"), tight.message
    assert np.abs(ctrl(wide)).max() > 1.16  # the range is in the way
    assert 1.15 - 1e-3 < np.abs(ctrl(tight)).max() < 1.15 + 1e-6
    assert tight.objective > wide.objective
