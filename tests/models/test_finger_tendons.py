"""Fingers of which one tendon flexes two joints: a joint that is locked at zero leaves the tendon to the other."""

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


def test_a_joint_of_a_tendon_that_is_locked_at_zero_leaves_the_tendon_to_the_others():
    whole = mujoco.MjModel.from_xml_string(FINGER)
    finger = load_mechanism(FINGER, selection=Selection(lock={"far": 0.0}))
    locked = finger.model
    assert [joint.name for joint in finger.joints] == ["near"]
    data, held = mujoco.MjData(whole), mujoco.MjData(locked)
    for angle, speed in ((0.3, 0.0), (-0.2, 1.1)):
        data.qpos[:], data.qvel[:], data.ctrl[:] = (0.0, angle), (0.0, speed), 0.1
        held.qpos[:], held.qvel[:], held.ctrl[:] = angle, speed, 0.1
        mujoco.mj_forward(whole, data)
        mujoco.mj_forward(locked, held)
        np.testing.assert_allclose(held.ten_length, data.ten_length)
        np.testing.assert_allclose(held.sensordata, data.sensordata)
        np.testing.assert_allclose(held.qfrc_passive, data.qfrc_passive[1:])
        np.testing.assert_allclose(held.qfrc_actuator, data.qfrc_actuator[1:])
    for name in ("tendon_range", "tendon_frictionloss", "tendon_armature", "tendon_limited"):
        np.testing.assert_array_equal(getattr(locked, name), getattr(whole, name))


def test_a_joint_of_a_tendon_is_not_locked_elsewhere_than_at_zero():
    with pytest.raises(ModelError, match=r"'far' cannot be locked: tendon 'cord' uses it.*only if the joint is locked at 0"):
        load_mechanism(FINGER, selection=Selection(lock={"far": 10.0}))
