"""What somebody types who has not read the manual: one line that says what was meant, exit code 2, and nothing lost."""

import sys

import pytest

from linkplan.cli.main import main
from linkplan.models.errors import closest
from linkplan.models.extras import EXTRAS
from tests.support.mechanisms import FLAT_PARALLELOGRAM

PROBLEM = """[mechanism]
model = "optimus-knee"
[motion]
kind = "reach"
start_deg = { O = -49.07 }
goal_deg = { O = 56.27 }
duration_s = 0.16
"""
SAVED = ("plan.json", "trajectory.npz", "trajectory.csv", "plan.png")
# command line, words that its one line must hold
TYPED = [
    # in the wrong order, misspelled, without quotes
    (["--json", "plan", "leg.toml"], ["unrecognized arguments: --json"]),
    (["plna", "leg.toml"], ["invalid choice: 'plna' (did you mean 'plan'?)"]),
    (["plan", "leg.toml", "--ouput", "my"], ["unrecognized arguments: --ouput my (did you mean '--output'?)"]),
    (
        ["track", "knee-reach", "--kp", "5"],
        ["unrecognized arguments: --kp 5 (keys of the problem are set by --set KEY=VALUE)"],
    ),
    (["plan", "leg.toml", "--verbose"], ["unrecognized arguments: --verbose", "linkplan plan --help says more"]),
    (["plan", "leg.toml", "--set", "motion.duration_s", "=", "0.2"], ["unrecognized arguments: = 0.2"]),
    (["plan", "my", "leg.toml"], ["unrecognized arguments: leg.toml"]),
    (["plan"], ["required: PROBLEM"]),
    # a plan's folder where a problem or a model belongs, and the reverse
    (["plan", "planned"], ["problem 'planned' is a saved plan; a problem is a TOML file"]),
    (["plan", "planned/plan.json"], ["a file of the saved plan 'planned'", "TOML"]),
    (["check", "planned"], ["model 'planned' is a saved plan", "MJCF"]),
    (["bode", "planned"], ["model 'planned' is a saved plan; give the file of its problem"]),
    (["batch", "planned"], ["batch 'planned' is a saved plan", "[sweep]"]),
    (["track", "planned/plan.json"], ["a file of the saved plan 'planned'", "name its folder"]),
    (["batch", "leg.toml"], ["batch 'leg.toml' is a problem file, for plan"]),
    (["plan", "sweep.toml"], ["'sweep.toml' is a batch file, for batch"]),
    # a tracking motion without a reference
    (["plan", "leg.toml", "--set", "motion.kind=track"], ["motion.kind 'track' needs a [reference]"]),
    # units
    (["plan", "leg.toml", "--set", "motion.goal_rad.O=1"], ["did you mean 'goal_deg'?"]),
    (["plan", "leg.toml", "--set", "motion.duration_s=160ms"], ["motion.duration_s must be a positive number", "'160ms'"]),
    (["plan", "leg.toml", "--set", "motion.goal_deg.O=1e6"], ["motion.goal_deg of joint O", "100 turns", "36000", "1e+06"]),
    (["plan", "leg.toml", "--set", "limits.effort.O=5"], ["actuator in limits.effort 'O'", "act_O"]),  # the name before 5
]


@pytest.fixture
def here(tmp_path, monkeypatch):
    (tmp_path / "leg.toml").write_text(PROBLEM, encoding="utf-8")
    (tmp_path / "sweep.toml").write_text('problem = "leg.toml"\n[sweep]\n"motion.goal_deg.O" = [45, 50]\n', encoding="utf-8")
    (tmp_path / "planned").mkdir()
    for name in SAVED:
        (tmp_path / "planned" / name).write_text("{}", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(("argv", "words"), TYPED, ids=[" ".join(argv) for argv, _ in TYPED])
def test_it_is_refused_in_a_line_that_says_what_was_meant(argv, words, here, capsys):
    before = sorted(here.rglob("*"))
    code = main(argv)
    out, err = capsys.readouterr()
    assert (code, out, err.count("\n")) == (2, "", 1), err
    for word in words:
        assert word in err
    assert sorted(here.rglob("*")) == before


def test_a_goal_of_thousands_of_turns_is_no_work_for_check(capsys):
    assert main(["check", "slider-crank-turn", "--set", "motion.goal_deg.O=1e6"]) == 0
    assert "the problem cannot be planned: motion.goal_deg of joint O must be within 100 turns" in capsys.readouterr().out


def test_check_goes_on_with_a_command_that_finds_a_pose_or_puts_motors(tmp_path, ask):
    flat, floating = tmp_path / "flat.xml", tmp_path / "floating.xml"
    flat.write_text(FLAT_PARALLELOGRAM, encoding="utf-8")
    _, out, _ = ask("check", str(flat))
    assert f"next: linkplan new {flat} -o problem.toml starts from that pose" in out
    floating.write_text(
        """<mujoco><worldbody><body><freejoint/><geom size="0.1"/><body pos="0.2 0 0"><joint name="arm" axis="0 1 0"/>
          <geom size="0.05" pos="0.1 0 0"/></body></body></worldbody></mujoco>""",
        encoding="utf-8",
    )
    _, out, _ = ask("check", str(floating))
    assert f"next: linkplan new {floating} --drive arm -o problem.toml puts motors on these joints" in out


def test_check_of_a_problem_without_motors_goes_on_with_the_problem(tmp_path, ask):
    (tmp_path / "arm.xml").write_text(
        """<mujoco><worldbody><body><joint name="arm" axis="0 1 0"/><geom size="0.05" pos="0.1 0 0"/></body></worldbody>
          </mujoco>""",
        encoding="utf-8",
    )
    (tmp_path / "arm.toml").write_text('[mechanism]\nmodel = "arm.xml"\n', encoding="utf-8")
    problem = str(tmp_path / "arm.toml")
    command = f"check {problem} --set mechanism.closure_tolerance_m=1e-6 --drive arm"
    _, out, _ = ask("check", problem, "--set", "mechanism.closure_tolerance_m=1e-6")
    assert f"next: linkplan {command} puts motors on these joints" in out
    _, out, _ = ask(*command.split())
    assert f"next: linkplan plan {problem}" in out


def test_new_takes_keys_of_the_mechanism(ask):
    """A model whose loops are open by rounding needs its tolerance there."""
    code, out, _ = ask("new", "five-bar", "--set", "mechanism.closure_tolerance_m=2e-6")
    assert code == 0
    assert "closure_tolerance_m = 2e-06" in out
    code, _, err = ask("new", "five-bar", "--set", "motion.duration_s=2")
    assert code == 2
    assert "new takes settings of [mechanism] only, because it writes the other sections; got motion" in err


# command line, the word that is meant
MISSPELLED = [
    (["plan", "knee-reach", "--set", "motion.goal_deg.o=10"], "O"),
    (["plan", "{folder}/leg.tmol"], "{folder}/leg.toml"),
    (["check", "{folder}/leg.xlm"], "{folder}/leg.xml"),
    (["track", "{folder}/plannd"], "{folder}/planned"),
    (["batch", "{folder}/lge.toml"], "{folder}/leg.toml"),
]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "leg.xml").write_text("", encoding="utf-8")
    (tmp_path / "leg.toml").write_text("", encoding="utf-8")
    (tmp_path / "planned").mkdir()
    return tmp_path


@pytest.mark.parametrize(("argv", "meant"), MISSPELLED, ids=[" ".join(argv) for argv, _ in MISSPELLED])
def test_the_nearest_word_is_suggested(argv, meant, folder, capsys):
    code = main([word.format(folder=folder) for word in argv])
    out, err = capsys.readouterr()
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert f"did you mean '{meant.format(folder=folder)}'?" in err


def test_what_is_close_to_nothing_is_refused_with_what_there_is(ask):
    code, _, err = ask("plan", "/no/such/folder/anywhere.toml")
    assert code == 2
    assert "did you mean" not in err


def test_a_folder_in_common_makes_no_name_close(tmp_path, ask):
    (tmp_path / "leg.toml").write_text("", encoding="utf-8")
    assert "did you mean" not in ask("plan", str(tmp_path / "spider.xyz"))[2]


def test_beginnings_of_options_and_negative_values_are_taken_as_before(ask):
    code, out, _ = ask("check", "optimus-knee", "--at-d", "-3")
    assert code == 0
    assert "-3" in out
    assert "'o' is not in mechanism" in ask("check", "optimus-knee", "--at-deg", "o=3")[2]  # a value, and not -o
    assert "--kd must be a number of at least 0, got -1" in ask("bode", "optimus-knee", "--kd", "-1")[2]


def test_capitals_do_not_make_a_name_far():
    assert closest("o", ["A", "O", "C"]) == "O"
    assert closest("ACT_O", ["act_O", "act_B_to_D"]) == "act_O"
    assert closest("zz", ["A", "O", "C"]) is None


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


@pytest.mark.parametrize(
    ("module", "arguments", "feature"),
    [
        ("pyarrow", ["experiment", "knee-reach", "--samples", "2"], "experiment"),
        ("pyarrow", ["plan", "knee-reach", "--parquet", "-o", "OUT"], "--parquet"),
        ("av", ["render", "knee-reach", "-o", "OUT.mp4"], "an .mp4"),
        ("distributed", ["experiment", "knee-reach", "--cluster", "tcp://nowhere:1"], "a cluster"),
    ],
)
def test_a_command_without_its_package_ends_in_one_line_before_it_plans(
    monkeypatch, ask, tmp_path, module, arguments, feature
):
    monkeypatch.setitem(sys.modules, module, None)
    code, out, err = ask(*(word.replace("OUT", str(tmp_path / "out")) for word in arguments))
    assert (code, out) == (2, "")
    assert err.count("\n") == 1, err
    assert err.strip().endswith(f"pip install 'linkplan[{EXTRAS[module][1]}]'")
    assert f"{feature} needs" in err
    assert not list(tmp_path.iterdir())
