"""Rolling joints of fingers: a fixed tendon whose range leaves two hinges almost no play couples them."""

import mujoco
import numpy as np
import pytest

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
