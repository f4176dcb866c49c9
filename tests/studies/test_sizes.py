"""Lengths in the loop studies come from what moves, not from what the file says to the viewer."""

import numpy as np
import pytest

from linkplan.controllers.sampling import sampling
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.feedback.bode.poses import loop_poses
from linkplan.studies.feedback.frequency.excitation import Setup, signal_amplitude
from linkplan.studies.feedback.frequency.feasible import default_amplitudes
from linkplan.studies.feedback.frequency.feedback_loops import feedback_loop, law_gain, operating_point

CART = """<mujoco><statistic extent="{extent}"/><option gravity="0 0 0" timestep="1e-3"/><worldbody><body name="cart">
<joint name="X" type="slide" axis="1 0 0"/><geom type="box" size="0.1 0.1 0.1" mass="1"/></body></worldbody>
<actuator><motor name="push" joint="X" ctrlrange="-1000 1000"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def carts():
    """A cart as it is, and one whose file tells the viewer of a kilometre."""
    return [load_mechanism(CART.format(extent=extent)) for extent in (0.3, 1000.0)]


def test_the_file_says_a_size_that_is_not_the_mechanisms(carts):
    plain, told = carts
    assert told.model.stat.extent > 1000 * plain.model.stat.extent
    assert told.extent_m < 3 * plain.extent_m


def test_amplitudes_are_of_the_size_of_what_moves(carts):
    plain, told = (default_amplitudes(operating_point(cart, np.zeros(1))) for cart in carts)
    np.testing.assert_allclose(told / plain, carts[1].extent_m / carts[0].extent_m)


def test_test_signals_are_of_the_size_of_what_moves(carts):
    found = []
    for cart in carts:
        point, settings = operating_point(cart, np.zeros(1)), Tracking(kp=100.0, kd=20.0, period_s=1e-3)
        loop = feedback_loop(point, law_gain(point, "pd", settings, cart.effort_limit), sampling(cart, 1e-3))
        found.append(signal_amplitude(loop, np.array([1.0]), "reference", cart.effort_limit, Setup(), 0)[0])
    assert found[1] / found[0] == pytest.approx(carts[1].extent_m / carts[0].extent_m)


def test_poses_of_a_slide_without_stops_lie_within_the_mechanisms_size(carts):
    for cart in carts:
        poses = loop_poses(cart, None, cart.effort_limit).positions
        assert np.ptp(poses) <= cart.extent_m
        assert np.ptp(poses) > 0
