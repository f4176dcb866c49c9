"""Wrong files with phases: each is refused in one line, before anything is solved."""

import tomllib

import pytest

from linkplan.planner.problem.phases import PhasedProblem
from linkplan.planner.search.phase_poses import phase_poses
from linkplan.planner.search.phase_set import phase_set
from tests.support.refusals import assert_refused

HOPPER = """<mujoco model="hopper"><worldbody><body name="foot"><joint name="z" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass="2" diaginertia=".1 .1 .1"/><site name="sole"/><body name="body">
<joint name="leg" type="slide" axis="0 0 1" range="0 0.3" limited="true"/>
<inertial pos="0 0 0" mass="8" diaginertia=".1 .1 .1"/></body></body></worldbody>
<actuator><motor name="leg" joint="leg" ctrlrange="-300 300" ctrllimited="true"/></actuator></mujoco>"""
FILE = """
[mechanism]
model = "hopper.xml"
[contacts.toe]
site = "sole"
friction = 0.6
[[phases]]
name = "push"
on = ["toe"]
duration_s = 0.25
start_m = { leg = 0.0 }
[[phases]]
name = "flight"
goal_m = { leg = 0.3 }
[motion]
duration_s = "free"
[objective]
maximize = { com_height = "apex" }
"""
# What is written in place of what, and words of the refusal.
WRONG = {
    "unknown contact": ('on = ["toe"]', 'on = ["heel"]', "unknown contact of phases[0].on 'heel'"),
    "unknown site": ('"sole"', '"soles"', "unknown site in contacts.toe.site 'soles' (did you mean 'sole'?)"),
    "no site": ('"sole"', "[]", "contacts.toe.site needs at least one site"),
    "two phases of one name": ('"flight"', '"push"', "two phases have the name 'push'"),
    "a name that is no folder": ('"flight"', '"a/b"', "phases[1].name must be a word that can name a folder"),
    "negative friction": ("0.6", "-0.6", "contacts.toe.friction must be a number of at least 0, got -0.6"),
    "unknown plane": ("friction = 0.6", 'plane = "floor"', "unknown geom in contacts.plane 'floor'"),
    "a goal out of range": ("0.3 }", "0.5 }", "phases[1].goal_m.leg must be within the joint's range from 0 to 0.3 m"),
    "a start that cannot stand": ("{ leg = 0.0", "{ z = 0.5, leg = 0.0", "there is no pose with toe on the ground"),
    "a place in the air": ("goal_m", "at = { toe = [0, 0, 0] }\ngoal_m", "phases[1].at names contact toe, which is not in"),
    "a site that stands twice": ('["toe"]', '["toe", "toe"]', "site 'sole' stands twice"),
    "two places at one time": (
        '[[phases]]\nname = "flight"',
        'goal_m = { leg = 0.1 }\n[[phases]]\nname = "flight"\nstart_m = { leg = 0.2 }',
        "joint 'leg' is at one place where phase push ends",
    ),
    "a distance without a gait": ('"free"', '"free"\ndistance_m = 0.0', "motion.distance_m belongs to a gait"),
    "a distance without a base": (
        '"free"',
        '"free"\nrepeat = true\ndistance_m = 1.0',
        "a base that slides along the ground",
    ),
    "an unknown joint in the mirror": ('"free"', '"free"\nrepeat = true\nmirror = { leg = "lag" }', "joint 'lag' is not in"),
    "a joint that mirrors two": ('"free"', '"free"\nrepeat = true\nmirror = { leg = "z", z = "z" }', "exchanges with two"),
    "a joint of the other kind": ("start_m", "start_deg", "use phases[0].start_m, not start_deg"),
    "a time that is too short": ('"free"', "0.2", "motion.duration_s must be at least the 0.25 s of phases, got 0.2"),
    "bounds in the wrong order": (
        '"flight"',
        '"flight"\nmin_duration_s = 2\nmax_duration_s = 1',
        "phase flight: motion.min_",
    ),
    "two objectives": ("maximize", 'minimize = "time"\nmaximize', "are two objectives; keep one"),
    "nothing to maximise": ('{ com_height = "apex" }', "{}", "objective.maximize must have com_height, distance or both"),
}


def prepared(text: str, tmp_path) -> None:
    """Read a file with phases and set up its phases, without a solve."""
    (tmp_path / "hopper.xml").write_text(HOPPER, encoding="utf-8")
    asked = PhasedProblem.from_tables("asked", tomllib.loads(text), tmp_path)
    phase_set(asked, phase_poses(asked))


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_file_with_phases_is_refused_in_one_line(tmp_path, case):
    written, instead, words = WRONG[case]
    assert written in FILE
    text = FILE.replace(written, instead, 1)
    assert_refused(lambda: prepared(text, tmp_path), words)


def test_the_file_is_right_without_its_fault(tmp_path):
    prepared(FILE, tmp_path)


def test_a_setting_of_an_unknown_phase_is_refused(tmp_path):
    path = tmp_path / "hop.toml"
    path.write_text(FILE, encoding="utf-8")
    assert_refused(lambda: PhasedProblem.from_file(path, {"phases.0.rest": True}), "unknown phase '0'; legal: push, flight")
