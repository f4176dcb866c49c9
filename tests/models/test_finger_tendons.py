"""Fingers of which one tendon flexes two joints: a joint that is locked leaves the tendon to the other."""

import mujoco
import numpy as np
import pytest

from linkplan.models.errors import ModelError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.selection import Selection

FINGER = """<mujoco><compiler angle="degree"/><option timestep="1e-4"/><worldbody><body name="middle">
  <joint name="far" axis="0 1 0" range="0 60"/><geom type="capsule" fromto="0 0 0 0.05 0 0" size="0.01"/>
  <body name="tip" pos="0.05 0 0"><joint name="near" axis="0 1 0" range="-60 60"/>
  <geom type="capsule" fromto="0 0 0 0.04 0 0" size="0.01"/></body></body></worldbody>
  <tendon><fixed name="cord" range="-1 1.2" limited="true" stiffness="3" springlength="0.2" damping="0.4" frictionloss="0.01"
    armature="1e-4"><joint joint="far" coef="2"/><joint joint="near" coef="1.5"/></fixed></tendon>
  <actuator><position name="flexor" tendon="cord" kp="3" ctrlrange="-1 1"/></actuator>
  <sensor><tendonpos name="length" tendon="cord"/></sensor></mujoco>"""


@pytest.mark.parametrize("far_deg", [0.0, 10.0])
def test_a_joint_of_a_tendon_that_is_locked_leaves_the_tendon_to_the_others(far_deg):
    whole = mujoco.MjModel.from_xml_string(FINGER)
    finger = load_mechanism(FINGER, selection=Selection(lock={"far": far_deg}))
    locked, far = finger.model, np.radians(far_deg)
    assert [joint.name for joint in finger.joints] == ["near"]
    data, held = mujoco.MjData(whole), mujoco.MjData(locked)
    for angle, speed in ((0.3, 0.0), (-0.2, 1.1)):
        data.qpos[:], data.qvel[:], data.ctrl[:] = (far, angle), (0.0, speed), 0.1
        held.qpos[:], held.qvel[:], held.ctrl[:] = angle, speed, 0.1
        mujoco.mj_forward(whole, data)
        mujoco.mj_forward(locked, held)
        np.testing.assert_allclose(held.ten_length + 2 * far, data.ten_length)
        np.testing.assert_allclose(held.sensordata + 2 * far, data.sensordata)
        np.testing.assert_allclose(held.qfrc_passive, data.qfrc_passive[1:])
        np.testing.assert_allclose(held.qfrc_actuator, data.qfrc_actuator[1:])
    np.testing.assert_allclose(locked.tendon_range + 2 * far, whole.tendon_range)
    for name in ("tendon_frictionloss", "tendon_armature", "tendon_limited"):
        np.testing.assert_array_equal(getattr(locked, name), getattr(whole, name))


def test_a_joint_of_a_tendon_whose_spring_rests_at_the_reference_pose_is_locked_at_zero_alone():
    relaxed = FINGER.replace('springlength="0.2"', "")
    with pytest.raises(ModelError, match=r"'far' cannot be locked: tendon 'cord' uses it.*lock the joint at 0"):
        load_mechanism(relaxed, selection=Selection(lock={"far": 10.0}))
    assert load_mechanism(relaxed, selection=Selection(lock={"far": 0.0})).dof == 1
