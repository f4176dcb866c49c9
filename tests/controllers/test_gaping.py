"""The gap of closures in a batch is the mechanism's own, whatever ties the points."""

import mujoco
import numpy as np
import pytest
from mujoco.batch import Batch

from linkplan.controllers.imperfections.batch_effects import ClosureWatch
from linkplan.models.mechanism import load_mechanism
from tests.support.machines import reach

FOURBAR = """
<mujoco model="tied">
  <default><geom type="capsule" size="0.01" contype="0" conaffinity="0"/><joint axis="0 1 0"/></default>
  <worldbody>
    <body name="crank"><joint name="O"/><geom fromto="0 0 0 0 0 0.1"/>
      <body name="coupler" pos="0 0 0.1"><joint name="A"/><geom fromto="0 0 0 0.3 0 0"/></body></body>
    <body name="rocker" pos="0.3 0 0"><joint name="C"/><geom fromto="0 0 0 0 0 0.1"/></body>
  </worldbody>
  <equality>{tie}</equality>
  <actuator>{drive}</actuator>
</mujoco>"""
MOTOR = '<motor name="m" joint="O" ctrlrange="-5 5"/>'
TIES = {
    "bodies": '<connect body1="coupler" body2="rocker" anchor="0.3 0 0"/>',
    "the other way": '<connect body1="rocker" body2="coupler" anchor="0 0 0.1"/>',
}


@pytest.mark.parametrize("name", [*TIES, "sites of the knee"])
def test_the_gap_of_bodies_and_of_sites_is_the_mechanism_s(name):
    mechanism = load_mechanism(FOURBAR.format(tie=TIES[name], drive=MOTOR)) if name in TIES else reach()[0]
    pose = mechanism.home + np.array([0.01, -0.004, 0.02])
    batch = Batch(mechanism.model, nsim=2)
    batch.bind("qpos")[:] = pose
    watch = ClosureWatch(batch, [mechanism.model] * 2)
    batch.forward()
    watch.note()
    assert mechanism.gap_m(pose) > 1e-4
    assert watch.largest()[0] == pytest.approx(mechanism.gap_m(pose))


def test_the_largest_gap_of_all_steps_is_kept_however_many_there_are():
    mechanism, _ = reach()
    off = np.array([0.01, -0.004, 0.02])
    batch = Batch(mechanism.model, nsim=1)
    watch = ClosureWatch(batch, [mechanism.model])
    for k in range(200):
        batch.bind("qpos")[:] = mechanism.home + (off if k == 70 else 0.1 * off)
        batch.forward()
        watch.note()
    assert watch.largest()[0] == pytest.approx(mechanism.gap_m(mechanism.home + off))


# A ball on a slide that touches the ground up to a height of its radius.
FALLING = """<mujoco><worldbody><geom type="plane" size="1 1 1"/>
<body pos="0 0 1"><joint name="J" type="slide" axis="0 0 1"/><geom size="0.1" mass="1"/></body></worldbody></mujoco>"""


def test_the_largest_number_of_contacts_of_each_simulation_is_kept():
    model = mujoco.MjModel.from_xml_string(FALLING)
    batch = Batch(model, nsim=2)
    watch = ClosureWatch(batch, [model] * 2)
    for heights in ([-0.5, -0.5], [-0.95, -0.5], [-0.5, -0.5]):
        batch.bind("qpos")[:, 0] = heights
        batch.forward()
        watch.note()
    assert watch.largest()[1].tolist() == [1, 0]
    batch.bind("qpos")[:, 0] = [-0.5, -0.95]
    batch.forward()
    watch.note()
    assert watch.largest()[1].tolist() == [1, 1]


def test_copies_of_many_machines_take_at_most_eight_mebibytes():
    model, n = load_mechanism("optimus-knee").model, 600
    batch = Batch(model, nsim=n)
    batch.forward()
    watch = ClosureWatch(batch, [model] * n)
    copied = sum(array.nbytes for array in watch._copies.values())
    assert 4 * 2**20 < copied <= 8 * 2**20
    for _ in range(100):
        watch.note()
    assert np.ptp(watch.largest()[0]) == 0.0
