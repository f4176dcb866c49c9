"""Tendons whose ranges leave no play, and tendons of fingers whose joints are locked."""

import mujoco
import numpy as np
import pytest

from linkplan.models.errors import ModelError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.models.selection import Selection
from tests.support.mechanisms import replaced

ROLLING = """<mujoco><compiler autolimits="true"/><worldbody><body name="virtual">
  <joint name="inner" axis="0 1 0" range="-60 60"/><geom size="0.01" mass="0.01"/><body name="bone" pos="0.02 0 0">
  <joint name="outer" axis="0 1 0" range="-60 60" ref="-5"/><geom type="capsule" fromto="0 0 0 0.04 0 0" size="0.01"/></body>
  </body></worldbody><tendon><fixed name="roll" range="0.08 0.12" solreflimit="0.003 1"><joint joint="inner" coef="1"/>
  <joint joint="outer" coef="-1"/></fixed></tendon><actuator><motor joint="outer" ctrlrange="-1 1"/></actuator></mujoco>"""


def test_a_tendon_whose_range_leaves_its_joints_no_play_couples_them_in_its_middle():
    finger = load_mechanism(ROLLING)
    assert [joint.name for joint in finger.independent_joints] == ["outer"]
    assert finger.notes[0] == "the ranges of tendons roll leave their joints almost no play: they are held in the middle"
    data = mujoco.MjData(finger.model)
    for outer in (-0.4, 0.3):
        data.qpos[:] = finger.qpos_of(close_at(finger, np.array([outer])))
        mujoco.mj_forward(finger.model, data)
        np.testing.assert_allclose(data.qpos, [outer + 0.1, outer])
        np.testing.assert_allclose([data.ten_length[0], data.efc_pos[0]], [0.1, 0.0], atol=1e-12)
    np.testing.assert_array_equal(finger.model.eq_solref[0], [0.003, 1])


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('range="0.08 0.12"', 'range="-0.1 0.1"'),
        ('range="0.08 0.12"', 'range="0.08 0.12" limited="false"'),
        ('range="-60 60"', ""),
        ("<worldbody>", '<option><flag limit="disable"/></option><worldbody>'),
    ],
    ids=["some play", "no limit", "joints that turn on", "no limits at all"],
)
def test_other_tendons_are_limits_as_they_were(old, new):
    assert load_mechanism(replaced(ROLLING, old, new)).dof == 2


def test_a_joint_that_is_locked_leaves_the_range_to_the_other():
    finger = load_mechanism(replaced(ROLLING, "0.08 0.12", "-0.001 0.001"), selection=Selection(lock={"inner": 10.0}))
    np.testing.assert_allclose(finger.model.tendon_range[0] + np.radians(10), [-0.001, 0.001])
    assert finger.dof == 1


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
