"""What `check` says of several coordinates: a stop of home's alone is no fault, rounding no effort, a loop has its gap."""

import json
import re

import numpy as np
import pytest

import linkplan
from linkplan.cli.main import main
from linkplan.models.actuation.distribution import distribute
from linkplan.models.mechanism import load_mechanism
from linkplan.studies.check.check_report import path_blocks
from linkplan.studies.check.inspection import inspect
from linkplan.studies.check.kinematic_loop_report import measured, reach_sweeps
from linkplan.studies.check.path_quantities import path_figures
from linkplan.studies.check.whole_check import check_whole
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
    """Return the paths of three hinged bodies along their reach; only the first body has a motor."""
    bodies = "".join(
        f'<body pos="{k} 0 0"><joint name="j{k}" axis="0 1 0"/><geom size="0.1" pos="0.3 0 0"/></body>' for k in range(3)
    )
    motor = '<motor name="m" joint="j0" ctrlrange="-1 1"/>'
    mechanism = load_mechanism(f"<mujoco><worldbody>{bodies}</worldbody><actuator>{motor}</actuator></mujoco>")
    return [*map(measured, reach_sweeps(mechanism, inspect(mechanism, []).reaches))]


def test_of_a_reach_the_sentences_name_the_coordinate_that_moves_and_no_other(tumbling):
    for path, name in zip(tumbling, ("j0", "j1", "j2"), strict=True):
        lines = text_of(path_blocks(path)).splitlines()
        said = [line for line in lines if " at j" in line and ("holds" in line or "asks" in line)]
        assert said
        assert all(re.findall(r"(j\d) =", line) == [name] for line in said)


def test_of_many_coordinates_what_stays_the_same_is_said_once(tumbling):
    texts = [text_of(path_blocks(path, brief=True)) for path in tumbling]
    assert [text.count("no actuator holds j1 still") for text in texts] == [1, 1, 0]
    assert [text.count("no actuator holds j2 still") for text in texts] == [1, 0, 1]


def test_at_its_dead_centre_an_actuator_holds_nothing():
    maps = np.array([[[25.0, 0.0], [0.0, 2.6e-13]], [[25.0, 0.0], [0.0, 1e-3]]])
    found = distribute(np.array([[50.0, 7.0], [50.0, 7.0]]), maps, np.array([-np.inf, np.inf]))
    assert found == pytest.approx(np.array([[2.0, 0.0], [2.0, 7e3]]))


def test_each_open_loop_is_named_with_the_gap_of_its_own_unit():
    text = """<mujoco><worldbody><body><joint name="a"/><geom size="0.1"/></body><body pos="1 0 0"><joint name="b"/>
    <geom size="0.1"/></body><body pos="2 0 0"><joint name="c"/><geom size="0.1"/></body></worldbody><equality>
    <joint name="off" joint1="a" joint2="b" polycoef="0.1 1 0 0 0"/><joint name="shut" joint1="c" joint2="b"/></equality>
    <actuator><motor joint="b" ctrlrange="-1 1"/></actuator></mujoco>"""
    (said,) = (problem for problem in inspect(load_mechanism(text), []).problems if "is open by" in problem)
    assert said.startswith("loop off is open by 0.1 rad at the model's reference pose")


COAXIAL = """<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><joint name="b" axis="0 1 0" range="-90 90"/>
<geom size=".03" pos=".1 0 0"/></body></worldbody></mujoco>"""
WRIST = """<mujoco><worldbody><body><joint name="a" axis="0 0 1"/><joint name="b" axis="0 1 0" range="-90 90"/>
<joint name="c" axis="1 0 0"/><geom type="box" size=".1 .2 .3" contype="0" conaffinity="0"/></body></worldbody>
<actuator><motor joint="a" ctrlrange="-9 9"/>
<motor joint="b" ctrlrange="-9 9"/><motor joint="c" ctrlrange="-9 9"/></actuator>
</mujoco>"""
# A slide carries the tendon's one end through its other.
SLIDE = """<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><geom size=".03" pos=".1 0 0" contype="0"/>
<body><joint name="s" type="slide" axis="0 0 1" range="-.4 .4"/><geom size=".03" contype="0"/>
<site name="e"/></body><site name="t"/></body></worldbody>
<tendon><spatial name="cord" {pull}><site site="e"/><site site="t"/></spatial></tendon>
<actuator><motor joint="a" ctrlrange="-9 9"/><motor joint="s" ctrlrange="-9 9"/>{motor}</actuator></mujoco>"""
MOTOR = '<motor tendon="cord" ctrlrange="-9 9"/>'


@pytest.mark.filterwarnings("ignore:.*too close to singular")
def test_two_hinges_on_one_axis_are_a_problem_found_and_no_bad_input(tmp_path, capsys):
    (tmp_path / "lin1.xml").write_text(COAXIAL)
    assert main(["check", str(tmp_path / "lin1.xml"), "--json", "-o", str(tmp_path / "out")]) == 1
    said = json.loads(capsys.readouterr().out)
    assert said["dof"] == 2
    assert said["problems"][0].startswith("mechanism 'lin1' has a singular inertia at home (a = 0 deg, b = 0 deg): joints a")
    assert (tmp_path / "out" / "check.json").is_file()
    assert linkplan.check(tmp_path / "lin1.xml").problems == tuple(said["problems"])


def test_a_gimbal_lock_in_a_reach_is_a_note_that_names_joints_and_pose():
    found = check_whole(load_mechanism(WRIST), None)
    (note,) = [text for text in found.notes if "singular inertia" in text]
    assert note.startswith("singular inertia at b = -90 deg, in 2 of ")
    assert "joints a and c move together without moving any mass there" in note
    felt = path_figures(list(found.paths)[1]).reflected_inertia["actuator 0"]
    assert np.flatnonzero(np.isnan(felt)).tolist() == [0, len(felt) - 1]


@pytest.mark.parametrize(
    ("pull", "motor"),
    [("damping='1'", ""), ("stiffness='9'", ""), ("armature='1'", ""), ("range='0 1' limited='true'", ""), ("", MOTOR)],
    ids=["damper", "spring", "armature", "limit", "motor"],
)
def test_a_tendon_without_length_at_home_is_a_problem_that_names_its_sites(pull, motor):
    mechanism = load_mechanism(SLIDE.format(pull=pull, motor=motor))
    (said,) = [text for text in check_whole(mechanism, None).problems if "no length" in text]
    assert said.startswith("tendon cord has no length between e and t, which coincide at home: its force has no direction")
    still = np.zeros(2)
    assert np.isfinite(np.array(mechanism.dynamics.linearisation(mechanism.home, still, np.zeros(mechanism.n_u))[0])).all()


def test_a_tendon_that_pulls_nothing_may_have_no_length():
    found = check_whole(load_mechanism(SLIDE.format(pull="", motor="")), None)
    assert not any("no length" in text for text in (*found.problems, *found.notes))


def test_a_tendon_s_damper_acts_in_full_next_to_where_its_sites_meet():
    dynamics = load_mechanism(SLIDE.format(pull="damping='3'", motor="")).dynamics
    for s in (1e-12, -1e-3, 0.1):
        assert np.array(dynamics.passive([0, s], [0.0, 2.0])).ravel() == pytest.approx([0.0, -6.0])
