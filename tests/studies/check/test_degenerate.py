"""`check` of degenerate models: joints that move no mass and tendons without length are findings, each in a sentence."""

import json

import numpy as np
import pytest

import linkplan
from linkplan.models.mechanism import load_mechanism
from linkplan.studies.check.whole_check import check_whole
from linkplan.studies.cli.main import main

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
    felt = list(found.paths)[1].figures.reflected_inertia["actuator 0"]
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
