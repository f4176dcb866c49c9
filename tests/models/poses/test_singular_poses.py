"""Singular poses by kind: dead centres of a coordinate, branching poses, and those that a determinant only touches."""

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import reach
from linkplan.studies.check.inspection import inspect
from tests.support.mechanisms import replaced, slider_crank
from tests.support.overconstrained import bricard, coupled_cranks, sarrus
from tests.support.tolerances import BRANCHING

DRAWN = 0.5


def test_the_flat_pose_of_sarrus_linkage_is_found_though_its_determinant_changes_no_sign():
    mechanism = load_mechanism(sarrus(DRAWN))
    assert (mechanism.dof, len(mechanism.dependent)) == (1, 4)
    can = reach(mechanism)
    flat = [(position, rank) for position, rank in can.branching if can.lower.position < position < can.upper.position]
    assert len(flat) == 1
    assert abs(flat[0][0] + DRAWN) < BRANCHING
    assert flat[0][1] == 2
    assert flat[0][0] in can.singular


def test_check_says_that_the_closure_loses_rank_where_it_does():
    notes = inspect(load_mechanism(sarrus(DRAWN)), []).notes
    assert any("rank falls from 4 to 2" in note for note in notes)
    assert not any("dead centre of" in note for note in notes)


def test_a_parallelogram_branches_where_it_lies_flat():
    mechanism = load_mechanism(coupled_cranks(pivots=((0, 0), (0.2, 0)), drawn=DRAWN))
    can = reach(mechanism)
    assert [rank for _, rank in can.branching] == [1, 1]
    assert np.abs(np.array(can.singular) - (np.array([0.0, np.pi]) - np.pi + DRAWN)).max() < BRANCHING


@pytest.mark.parametrize(
    "text",
    [bricard(), replaced(slider_crank(1.0), '<motor joint="crank"', '<motor joint="slide"')],
    ids=["bricard", "slider"],
)
def test_a_dead_centre_of_the_coordinate_is_no_branching_pose(text):
    mechanism = load_mechanism(text)
    can = reach(mechanism)
    assert len(can.singular) == 2
    assert can.branching == ()
    notes = inspect(mechanism, []).notes
    assert sum("dead centre of" in note for note in notes) == 2
    assert not any("branch" in note for note in notes)


# Ranges

STILL = """<mujoco model="still"><compiler angle="radian"/><worldbody>
  <body name="trunk"><joint name="hip" axis="0 1 0"/><geom size="0.1" pos="0 0 0.2"/>
    <body name="head" pos="0 0 0.4"><joint name="neck" axis="0 1 0" range="0 1" limited="true"/>
      <geom size="0.05" pos="0 0 0.1"/></body></body>
  </worldbody>
  <equality><joint joint1="neck" polycoef="{at} 0 0 0 0"/></equality>
  <actuator><motor name="hip" joint="hip" ctrlrange="-9 9"/></actuator>
</mujoco>"""


@pytest.mark.parametrize("at", [0.0, -1e-11, -1e-3])
def test_a_joint_that_does_not_move_with_a_coordinate_does_not_stop_it(at):
    mechanism = load_mechanism(STILL.format(at=at))
    assert abs(mechanism.home[1] - at) < 1e-12
    assert reach(mechanism).turns_fully
