"""`check` of what is no mechanism as it stands, and of cylinders: reports with an exit code, and lines to paste."""

import json

import pytest

import linkplan
from linkplan.cli.main import main
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import load_mechanism
from linkplan.studies.check.inspection import inspect
from tests.support.mechanisms import replaced

BAR = """<mujoco model="bar"><worldbody>
<body name="crank"><joint name="O" axis="0 1 0"/><geom size=".01" pos="0 0 .05" contype="0"/>
<body name="coupler" pos="0 0 .1"><joint name="A" axis="0 1 0"/><geom size=".01" pos=".15 0 .05" contype="0"/></body></body>
<body name="rocker" pos=".3 0 0"><joint name="C" axis="0 1 0"/><geom size=".01" pos="0 0 .1" contype="0"/></body></worldbody>
<equality><connect name="B" body1="coupler" body2="rocker" anchor=".3 0 .1"/>%s</equality>
<actuator><motor joint="O" ctrlrange="-1 1"/></actuator></mujoco>"""
BRAKE = '<joint name="brake" joint1="O"/>'
# The same bar drawn with its rocker folded away: its pin stands open by 141 mm, more than its links can close from there.
OPEN = """<mujoco model="open"><worldbody>
<body name="crank"><joint name="O" axis="0 1 0"/><geom size=".01" pos=".05 0 0"/>
<body name="coupler" pos=".1 0 0"><joint name="A" axis="0 1 0"/><geom size=".01" pos=".1 0 0"/><site name="B1" pos=".3 0 0"/>
</body></body>
<body name="rocker" pos=".3 0 0"><joint name="C" axis="0 1 0"/><geom size=".01" pos=".1 0 0"/><site name="B2" pos=".2 0 0"/>
</body></worldbody>
<equality><connect name="B" site1="B1" site2="B2"/></equality>
<actuator><motor joint="O" ctrlrange="-1 1"/></actuator></mujoco>"""
# A boom on a hinge, raised by a cylinder whose stroke ends well inside the boom's own range.
BOOM = """<mujoco model="boom"><compiler angle="degree" autolimits="true"/>
<default><geom contype="0" conaffinity="0" size=".02"/></default><worldbody><body name="boom">
<joint name="boom" axis="0 -1 0" range="-60 80"/><geom pos=".5 0 0"/>
<site name="lug" pos=".5 0 0"/></body>
<body name="barrel" pos=".1 0 -.4"><joint name="barrel" axis="0 -1 0"/><geom pos=".1 0 .1"/>
<body name="rod" pos=".2 0 .2"><joint name="stroke" type="slide" axis="1 0 1" range="-.1 .2"/><geom pos=".1 0 .1"/>
<site name="eye" pos=".2 0 .2"/></body></body></worldbody>
<equality><connect name="pin" site1="lug" site2="eye" solref=".004 1"/></equality>
<actuator><motor name="push" joint="stroke" ctrlrange="-9000 9000"/></actuator></mujoco>"""


@pytest.fixture
def check(tmp_path, capsys):
    """Check a model's text; return exit code, stdout and stderr."""

    def run(text: str, *more: str) -> tuple[int, str, str]:
        path = tmp_path / "mine.xml"
        path.write_text(text, encoding="utf-8")
        code = main(["check", str(path), *more])
        return code, *capsys.readouterr()

    return run


def test_a_locked_mechanism_is_a_report_with_exit_code_one_that_names_what_locks_it(check, tmp_path):
    assert check(BAR % "")[0] == 0
    code, out, err = check(BAR % BRAKE, "-o", str(tmp_path / "checked"))
    assert (code, err) == (1, "")
    assert "PROBLEM: mechanism 'mine' is locked" in out
    assert "locked by: brake" in out
    said = json.loads((tmp_path / "checked" / "check.json").read_text(encoding="utf-8"))
    assert said["dof_gained_without"] == {"B": 2, "brake": 1}
    assert (said["locked"], said["dof"], len(said["problems"])) == (True, 0, 1)


@pytest.mark.parametrize("text", [BAR % BRAKE, OPEN], ids=["locked", "open"])
def test_python_reports_as_the_command_line_does(text, check, tmp_path):
    said = json.loads(check(text, "--json")[1])
    path = tmp_path / "mine.xml"
    found = linkplan.check(path)
    assert json.loads(json.dumps(found.to_dict())) == said
    assert found.problems == tuple(said["problems"])
    assert not found.notes
    assert f"PROBLEM: {said['problems'][0]}" in str(found)
    assert repr(found) == "RefusedModel('mine', 1 problems, 0 notes)"
    with pytest.raises(LinkplanError, match="nothing to draw"):
        found.plot()
    assert linkplan.check(text).problems
    problem = tmp_path / "reach.toml"
    motion = '[motion]\nkind = "reach"\nstart_deg = { O = 0 }\ngoal_deg = { O = 9 }\n'
    problem.write_text(f'[mechanism]\nmodel = "mine.xml"\n{motion}', encoding="utf-8")
    assert linkplan.check(problem).problems


def test_a_locked_mechanism_in_a_problem_is_reported_too_and_refused_by_plan(check, tmp_path, capsys):
    check(BAR % BRAKE)
    problem = tmp_path / "reach.toml"
    motion = '[motion]\nkind = "reach"\nstart_deg = { O = 0 }\ngoal_deg = { O = 9 }\n'
    problem.write_text(f'[mechanism]\nmodel = "mine.xml"\n{motion}', encoding="utf-8")
    capsys.readouterr()
    assert main(["check", str(problem)]) == 1
    assert "locked by: brake" in capsys.readouterr().out
    assert main(["plan", str(problem)]) == 2
    assert "without B (2 degrees of freedom), brake (1)" in capsys.readouterr().err


def test_an_open_loop_is_a_report_whose_lines_can_be_pasted(check):
    code, out, err = check(OPEN)
    assert (code, err) == (1, "")
    lines = [line.strip() for line in out.splitlines()]
    keyframe = next(line for line in lines if line.startswith("<keyframe>"))
    home = next(line for line in lines if line.startswith("home_deg = "))
    mended = replaced(OPEN, "</mujoco>", f"{keyframe}</mujoco>")
    assert "open by" not in check(mended)[1]
    assert load_mechanism(mended).home_gap_m < 1e-9
    assert check(OPEN, "--set", f"mechanism.{home}".replace(" = {", "={"))[1].startswith("mine: 1 degree of freedom")


def test_a_loop_that_assembly_closes_is_offered_the_pose_as_a_keyframe():
    apart = replaced(BAR % "", 'anchor=".3 0 .1"/>', 'anchor=".3 0 .1"/><weld active="false" body1="crank"/>')
    assert not any("keyframe in the model closes it" in note for note in inspect(load_mechanism(apart), []).notes)
    apart = replaced(OPEN, 'name="B2" pos=".2 0 0"', 'name="B2" pos=".05 0 .1"')
    mechanism = load_mechanism(apart)
    assert mechanism.home_gap_m > 0.01
    (note,) = (note for note in inspect(mechanism, []).notes if "keyframe in the model closes it" in note)
    mended = load_mechanism(replaced(apart, "</mujoco>", f"{note.partition(': ')[2]}</mujoco>"))
    assert mended.home_gap_m < 1e-9
    assert mended.home == pytest.approx(mechanism.home, abs=1e-8)


def test_a_cylinders_stops_inside_its_hinges_range_are_a_note():
    found = inspect(load_mechanism(BOOM, independent=["boom"]), [])
    assert [note for note in found.notes if "joint stroke's range" in note and "within boom's own range" in note]
    assert not any("stroke" in problem for problem in found.problems)


def test_a_hinges_stops_inside_another_hinges_range_are_a_note():
    text = replaced(
        BAR % "", '<joint name="O" axis="0 1 0"/>', '<joint name="O" axis="0 1 0" limited="true" range="-90 90"/>'
    )
    text = replaced(text, '<joint name="C" axis="0 1 0"/>', '<joint name="C" axis="0 1 0" limited="true" range="-5 5"/>')
    found = inspect(load_mechanism(text), [])
    assert not any("joint C's range" in problem for problem in found.problems)
    assert any("joint C's range" in note and "O's own range" in note for note in found.notes)
