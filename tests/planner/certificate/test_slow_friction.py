"""How much of a motion is too slow for its dry friction, in closed form."""

import numpy as np
import pytest

import linkplan
from linkplan.planner.closed_chain.case import slow_share
from linkplan.planner.trajectory import Trajectory
from tests.support.motions import motion_along

RUBBING = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="J" axis="0 1 0"{friction}/>
<inertial pos="0 0 0" mass="1" diaginertia="0.3 0.3 0.3"/></body></worldbody>
<actuator><motor name="motor" joint="J" ctrlrange="-4 4"/></actuator></mujoco>"""
# Of 400 samples.
SHARE = 0.005


def speeding_up(fastest: float) -> Trajectory:
    """Return a motion in 2 s from rest to a speed [rad/s] at a constant acceleration."""
    return motion_along([0.0, 2.0], [0.0, 0.0, fastest])


@pytest.mark.parametrize("share", [0.1, 0.6])
@pytest.mark.parametrize("way", [1, -1])
def test_a_joint_is_too_slow_where_the_smooth_friction_is_below_nine_tenths(share, way):
    mechanism = linkplan.load_mechanism(RUBBING.format(friction=' frictionloss="0.1"'))
    slow = np.arctanh(0.9) * mechanism.friction_transition
    found = slow_share(mechanism, speeding_up(way * slow / share))
    assert found == (pytest.approx(share, abs=SHARE), "joint J")


def test_a_joint_that_stands_still_and_one_without_friction_are_not_too_slow():
    rubbing, smooth = (linkplan.load_mechanism(RUBBING.format(friction=one)) for one in (' frictionloss="0.1"', ""))
    assert slow_share(rubbing, speeding_up(0.0)) == (0.0, "joint J")
    assert slow_share(smooth, speeding_up(1.0)) is None
