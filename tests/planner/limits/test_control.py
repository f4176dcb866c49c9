"""Which efforts of a servo count as clamped: there, the ctrl is not limited."""

import mujoco
import numpy as np
import pytest

import linkplan
from linkplan.planner.limits.actuators import _ctrl, _ranged

# A position servo of 50 N.m/rad and 1 N.m: beyond 0.32 rad every ctrl of its range gives the clamp.
ARM = """<mujoco><compiler angle="radian"/><option gravity="0 0 0"/><worldbody><body><joint name="O" axis="0 1 0"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.02 0.02 0.02"/></body></worldbody>
<actuator><position name="servo" joint="O" kp="50" ctrlrange="-0.3 0.3" forcerange="-1 1"/></actuator></mujoco>"""
GAIN, CTRL_HIGH, ANGLE = 50.0, 0.3, 0.5


@pytest.mark.parametrize(("share", "is_clamped"), [(5e-5, True), (5e-4, False)])
def test_beside_a_clamped_instant_an_effort_within_a_ten_thousandth_of_the_clamp_counts_as_clamped(share, is_clamped):
    (actuator,) = linkplan.load_mechanism(ARM).actuators
    effort = np.array([-1.0, -1.0 + share, -1.0])
    ranged, bent = _ranged(actuator, ANGLE + effort / GAIN, effort, 3)
    assert bent.all()
    assert ranged[0] == pytest.approx(CTRL_HIGH, rel=1e-12)
    assert ranged[1] - CTRL_HIGH == pytest.approx(0.0 if is_clamped else share / GAIN, abs=1e-12)


def test_a_servo_s_ctrl_is_the_one_with_which_mujoco_gives_the_effort():
    """Of a lever arm's servo with every bias: effort = gain ctrl + b_0 + b_1 length + b_2 speed."""
    text = ARM.replace(
        '<position name="servo" joint="O" kp="50" ctrlrange="-0.3 0.3" forcerange="-1 1"/>',
        '<general name="servo" joint="O" gear="2" gainprm="7" biastype="affine" biasprm="0.4 -30 -3" ctrlrange="-5 5"/>',
    )
    mechanism = linkplan.load_mechanism(text)
    (actuator,) = mechanism.actuators
    data = mujoco.MjData(mechanism.model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = 0.3, -0.7, 1.1
    mujoco.mj_forward(mechanism.model, data)
    (effort,), (length,), (speed,) = data.actuator_force, data.actuator_length, data.actuator_velocity
    assert _ctrl(actuator, effort, length, speed) == pytest.approx(1.1, rel=1e-12)
