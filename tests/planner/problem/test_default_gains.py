"""Gains that a problem leaves out follow from the machine's inertia at its start, and one function decides them."""

import numpy as np
import pytest

import linkplan
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.default_gains import tracking_of
from linkplan.planner.problem.keys.key_table import key_table
from tests.support.tolerances_planner import SAME_FIGURE

# A point mass of 2 kg at 0.5 m: 0.5 kg m2 about the hinge.
ARM = """<mujoco><option timestep="{step}"/><worldbody><body><joint name="arm" axis="0 1 0"/>
<inertial pos="0.5 0 0" mass="2" diaginertia="1e-9 1e-9 1e-9"/><geom size="0.01" contype="0" mass="0"/></body></worldbody>
<actuator><motor name="drive" joint="arm" ctrlrange="-99 99"/></actuator></mujoco>"""
INERTIA = 0.5


def reach(step=1e-3, **tracking):
    asked = {"start_deg": {"arm": 0.0}, "goal_deg": {"arm": 30.0}, "duration_s": 1.0}
    return linkplan.Problem.reach(load_mechanism(ARM.format(step=step)), **asked, tracking=tracking)


@pytest.mark.parametrize(
    ("tracking", "step", "frequency"),
    [
        ({}, 1e-3, 2 * np.pi * 20),
        ({"period_s": 5e-3}, 1e-3, 40.0),
        ({}, 1e-2, 20.0),
        ({"bandwidth_hz": 2.0}, 1e-3, 4 * np.pi),
    ],
)
def test_gains_left_out_are_those_of_the_inertia_at_the_control_period(tracking, step, frequency):
    found = tracking_of(reach(step, **tracking))
    assert found.kp == pytest.approx(INERTIA * frequency**2, rel=0.05)  # two digits
    assert found.kd == pytest.approx(2 * INERTIA * frequency, rel=0.05)


def test_gains_given_stay_and_the_other_one_follows_from_the_inertia():
    both, one = tracking_of(reach(kp=200.0, kd=1.0)), tracking_of(reach(kp=200.0))
    assert (both.kp, both.kd) == (200.0, 1.0)
    assert (one.kp, one.kd) == (200.0, tracking_of(reach()).kd)
    assert reach(kp=200.0).to_dict()["tracking"] == {"kp": 200.0}
    assert "tracking" not in reach().to_dict()


def test_new_track_and_bode_use_the_same_gains():
    problem = reach()
    known = tracking_of(problem)
    tracked = linkplan.track(linkplan.plan(problem), "pd").to_dict()["gains"]
    assert (tracked["kp"], tracked["kd"]) == (known.kp, known.kd)
    loop = linkplan.bode(problem, at_deg=[{"arm": 30.0}], measure=False)
    assert loop.gains["kp"] == pytest.approx(known.kp, rel=SAME_FIGURE)
    assert loop.stable


def test_the_table_of_keys_says_how_gains_follow():
    words = {row.name: row.default_words for row in key_table() if row.section == "tracking"}
    assert words["kp"] == words["kd"] == "from the inertia at the start pose and the control period"
