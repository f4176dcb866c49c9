"""Options that may be given again: a joint has one value, and --lock adds to the locks of a problem file."""

import pytest

from linkplan.studies.cli.main import main

ARM = """<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><geom size=".1" pos=".3 0 0"/><body pos=".3 0 0">
<joint name="b" axis="0 1 0"/><geom size=".1" pos=".3 0 0"/><body pos=".3 0 0"><joint name="c" axis="0 1 0"/>
<geom size=".1" pos=".3 0 0"/></body></body></body></worldbody><actuator><motor joint="a"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("argv", "option"),
    [
        (["check", "{}", "--lock", "b=3", "--lock", "b=4"], "--lock"),
        (["check", "{}", "--lock", "b=3", "--lock", " b =3"], "--lock"),
        (["transfer", "{}", "--joints", "a", "--range-deg", "a=0:5", "--range-deg", "a=0:10"], "--range-deg"),
    ],
)
def test_a_joint_that_is_named_twice_is_refused(argv, option, tmp_path, capsys):
    (tmp_path / "arm.xml").write_text(ARM, encoding="utf-8")
    assert main([part.format(tmp_path / "arm.xml") for part in argv]) == 2
    said = capsys.readouterr().err
    assert f"{option}: names joint {argv[-1][:2].strip().partition('=')[0]} twice" in said
    assert len(said.splitlines()) == 1


def test_locks_of_the_command_line_add_to_those_of_the_file(tmp_path, capsys):
    (tmp_path / "arm.xml").write_text(ARM, encoding="utf-8")
    problem = tmp_path / "problem.toml"
    problem.write_text('[mechanism]\nmodel = "arm.xml"\nlock = {b = 3}\n', encoding="utf-8")
    main(["check", str(problem), "--lock", "c=4"])
    assert "1 degree of freedom" in capsys.readouterr().out
