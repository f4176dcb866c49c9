"""What `check` says of several coordinates: a stop of home's alone is no fault, rounding no effort, a loop has its gap."""

import re

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.along import least_effort
from linkplan.studies.check.check_report import path_blocks
from linkplan.studies.check.inspection import inspect
from linkplan.studies.check.kinematic_loop_report import measured, reach_sweeps
from linkplan.studies.output.text import text_of

# Two motors turn a platform's pitch and roll by gears, as ankles have: either alone runs into the roll's range.
ANKLE = """<mujoco><worldbody><body><joint name="pitch" axis="0 1 0"/><geom size="0.05" contype="0" conaffinity="0"/>
<body>
<joint name="roll" axis="1 0 0" range="-20 20"/><geom size="0.1" pos="0 0.1 0" contype="0" conaffinity="0"/></body></body>
<body><joint name="left" axis="0 1 0" range="-60 60"/><geom size="0.05" contype="0" conaffinity="0"/></body>
<body><joint name="right" axis="0 1 0" range="{right}"/><geom size="0.05" contype="0" conaffinity="0"/></body></worldbody>
<tendon><fixed name="sum">
<joint joint="left" coef="0.5"/><joint joint="right" coef="0.5"/><joint joint="pitch" coef="-1"/></fixed>
<fixed name="difference">
<joint joint="left" coef="0.5"/><joint joint="right" coef="{coef}"/><joint joint="roll" coef="-1"/></fixed></tendon>
<equality><tendon tendon1="sum"/><tendon tendon1="difference"/></equality><actuator>
<motor name="l" joint="left" ctrlrange="-9 9"/><motor name="r" joint="right" ctrlrange="-9 9"/></actuator></mujoco>"""


def test_a_stop_that_another_coordinate_may_give_way_to_is_a_note():
    found = inspect(load_mechanism(ANKLE.format(right="-60 60", coef="-0.5")), [])
    stop = "joint roll's range [-20, 20] deg stops the mechanism at left = -40 deg while the other coordinates stay at home"
    assert any(note.startswith(stop) for note in found.notes), found.notes
    assert not any("stops the mechanism" in problem for problem in found.problems)


def test_a_stop_that_no_other_coordinate_moves_is_a_note_with_the_joints_own_range():
    found = inspect(load_mechanism(ANKLE.format(right="-60 60", coef="0")), [])
    assert any("roll's range [-20, 20] deg stops the mechanism at left = -40 deg (left's" in text for text in found.notes)
    assert not any("roll's range" in text for text in found.problems)


@pytest.mark.parametrize(("gravity", "said"), [("0 0 -9810", True), ("0 -981 0", True), ("0 0 -24.8", False)])
def test_gravity_in_other_units_than_metres_is_noted_with_the_size_of_the_bodies(gravity, said):
    arm = '<body><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 300 0 0" size="10" mass="1"/></body>'
    found = inspect(load_mechanism(f'<mujoco><option gravity="{gravity}"/><worldbody>{arm}</worldbody></mujoco>'), [])
    notes = [note for note in found.notes if note.startswith("gravity is")]
    assert bool(notes) == said
    assert all("span 3" in note and "millimetres" in note for note in notes)


@pytest.fixture(scope="module")
def tumbling():
    bodies = "".join(
        f'<body pos="{k} 0 0"><joint name="j{k}" axis="0 1 0"/><geom size="0.1" pos="0.3 0 0"/></body>' for k in range(3)
    )
    motor = '<motor name="m" joint="j0" ctrlrange="-1 1"/>'
    return load_mechanism(f"<mujoco><worldbody>{bodies}</worldbody><actuator>{motor}</actuator></mujoco>")


def test_of_a_reach_the_sentences_name_the_coordinate_that_moves_and_no_other(tumbling):
    mechanism = tumbling
    paths = [*map(measured, reach_sweeps(mechanism, inspect(mechanism, []).reaches))]
    for path, name in zip(paths, ("j0", "j1", "j2"), strict=True):
        lines = text_of(path_blocks(path)).splitlines()
        said = [line for line in lines if " at j" in line and ("holds" in line or "asks" in line)]
        assert said
        assert all(re.findall(r"(j\d) =", line) == [name] for line in said)


def test_of_many_coordinates_what_stays_the_same_is_said_once(tumbling):
    mechanism = tumbling
    paths = [*map(measured, reach_sweeps(mechanism, inspect(mechanism, []).reaches))]
    texts = [text_of(path_blocks(path, brief=True)) for path in paths]
    assert [text.count("no actuator holds j1 still") for text in texts] == [1, 1, 0]
    assert [text.count("no actuator holds j2 still") for text in texts] == [1, 0, 1]


def test_at_its_dead_centre_an_actuator_holds_nothing():
    """Its arm, rounding, made it hold a published biped's foot by 2.8e10 N.m."""
    maps = np.array([[[25.0, 0.0], [0.0, 2.6e-13]], [[25.0, 0.0], [0.0, 1e-3]]])
    assert least_effort(np.array([[50.0, 7.0], [50.0, 7.0]]), maps) == pytest.approx(np.array([[2.0, 0.0], [2.0, 7e3]]))


def test_each_open_loop_is_named_with_the_gap_of_its_own_unit():
    text = """<mujoco><worldbody><body><joint name="a"/><geom size="0.1"/></body><body pos="1 0 0"><joint name="b"/>
    <geom size="0.1"/></body><body pos="2 0 0"><joint name="c"/><geom size="0.1"/></body></worldbody><equality>
    <joint name="off" joint1="a" joint2="b" polycoef="0.1 1 0 0 0"/><joint name="shut" joint1="c" joint2="b"/></equality>
    <actuator><motor joint="b" ctrlrange="-1 1"/></actuator></mujoco>"""
    (said,) = (problem for problem in inspect(load_mechanism(text), []).problems if "is open by" in problem)
    assert said.startswith("loop off is open by 0.1 rad at the model's reference pose")
