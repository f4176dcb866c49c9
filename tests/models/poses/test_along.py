"""Loops that coordinates outside of them leave alone."""

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import advance, follow, in_loops
from linkplan.models.poses.reach import reach, toggles

# A parallelogram whose rocker carries an arm: no loop turns with the arm.
ARM_ON_A_LOOP = """<mujoco><default><geom type="capsule" size=".01"/><joint axis="0 1 0"/></default><worldbody>
  <body name="crank"><joint name="crank"/><geom fromto="0 0 0 0 0 .1"/>
    <body name="bar" pos="0 0 .1"><joint name="bar"/><geom fromto="0 0 0 .2 0 0"/></body>
  </body>
  <body name="rocker" pos=".2 0 0"><joint name="rocker"/><geom fromto="0 0 0 0 0 .12"/>
    <body name="arm" pos="0 0 .1"><joint name="arm" range="-60 60"/><geom fromto="0 0 0 .1 0 .1"/></body>
  </body>
</worldbody>
<equality><connect body1="bar" body2="rocker" anchor=".2 0 0"/></equality>
<actuator><motor name="c" joint="crank"/><motor name="a" joint="arm"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def arm():
    return load_mechanism(ARM_ON_A_LOOP)


@pytest.fixture(scope="module")
def swept(arm):
    s = np.tile(arm.home[arm.independent], (40, 1))
    s[:, 1] += np.linspace(0.0, 0.9, 40)
    return follow(arm, s)


def test_the_coordinates_of_loops_are_known(arm):
    assert [joint.name for joint in arm.independent_joints] == ["crank", "arm"]
    assert in_loops(arm).tolist() == [True, False]
    assert not in_loops(load_mechanism("cart-pole")).any()


def test_what_moves_outside_the_loops_leaves_them_alone(arm, swept):
    assert np.ptp(swept[:, arm.independent[1]]) == pytest.approx(0.9)
    assert np.all(swept[:, arm.dependent] == arm.home[arm.dependent])
    np.testing.assert_allclose(swept[-1], advance(arm, arm.home, swept[-1][arm.independent])[0], atol=1e-12)


def test_the_reach_of_a_joint_outside_the_loops_is_its_range(arm):
    can = reach(arm, 1)
    assert np.degrees([can.lower.position, can.upper.position]) == pytest.approx([-60, 60])
    assert (can.singular, toggles(arm, 1)) == ((), ())
