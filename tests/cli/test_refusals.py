"""Bad input on the command line: exit code 2, one line on stderr, nothing on stdout, nothing on disk."""

import shutil

import pytest

from linkplan.cli.main import main
from linkplan.controllers.trackers.names import TRACKERS

OPEN_TREE = """<mujoco><worldbody><body><joint name="h" axis="0 1 0"/><geom size="0.1"/></body></worldbody></mujoco>"""

# command line, words that its one line must hold
REFUSALS = [
    (["plan", "knee-reech"], ["knee-reech", "did you mean 'knee-reach'"]),
    (["plan", "no/such/problem.toml"], ["unknown problem 'no/such/problem.toml': there is no such file"]),
    (["plan", "{binary}"], ["UTF-8"]),
    (["plan", "{open_tree}"], ["is a model, for check and new", "TOML"]),
    (["batch", "{empty_toml}"], ["names no problem", "[[case]] or [sweep]"]),
    (["plan", "knee-reach", "--set", "motions.kind=reach"], ["motions", "did you mean 'motion'"]),
    (["plan", "knee-reach", "--set", "motion.goal_deg.O=79"], ["beyond reach", "-90 to 78.5217"]),
    (["plan", "knee-sine", "--set", "reference.amplitude_deg.O=90"], ["beyond reach"]),
    (["check", "optimus-knee", "--at-deg", "O=1,5"], ["--at-deg", "JOINT=VALUE"]),
    (["check", "optimus-knee", "--at-deg", "O=1,O=2"], ["--at-deg"]),
    (["check", "optimus-knee", "--at-deg", "Q=3"], ["'Q'", "O, A, C"]),
    (["check", "optimus-knee", "--at-deg", "O=-100"], ["the pose O = -100 deg is beyond reach", "from -90"]),
    (["bode", "optimus-knee", "--kd", "-1"], ["--kd", "-1"]),
    (["bode", "optimus-knee", "--kp", "0", "--kd", "0"], ["no feedback"]),
    (["bode", "{open_tree}"], ["actuator"]),
    (["bode", "optimus-knee-source"], ["cannot be held", "act_B_to_D would need 0 N", "0 to 0.2", "effort to both sides"]),
    (["bode", "cart-pole", "--at-deg", "pole=30"], ["no effort holds 'cart-pole' at cart = 0 m"]),
    (["bode", "optimus-knee", "--tracker", "mpc"], ["mpc", "pd, pd+ff, lqr"]),
    (["bode", "optimus-knee", "--frequency-hz", "1:10:1"], ["--frequency-hz", "LOW:HIGH:N"]),
    (["bode", "optimus-knee", "--amplitude-deg", "0"], ["--amplitude-deg"]),
    (["bode", "optimus-knee", "--period-s", "-0.001"], ["--period-s", "-0.001"]),
    (["bode", "optimus-knee", "--along"], ["--along", "problem"]),
    (["bode", "knee-reach", "--set", "limits.effort.act_O=[-2, 2]", "--at-deg", "O=50"], ["cannot be held", "act_O", "N.m"]),
    (["tune", "optimus-knee"], ["--bandwidth-hz"]),
    (["tune", "optimus-knee", "--bandwidth-hz", "5000"], ["5000 Hz is not below the Nyquist frequency, 5000 Hz"]),
    (["tune", "knee-reach", "--bandwidth-hz", "9", "--set", "tracking.lqr_position_deg=1,0"], ["'1,0'", "write 1.5"]),
    (["track", "knee-reach", "--tracker", "smc"], ["smc", ", ".join(TRACKERS)]),
    (["track", "{not_a_plan}"], ["has no plan.json"]),
    (["track", "{a_plan}", "--sample", "3"], ["holds no experiment", "experiment.json"]),
    (
        ["track", "{a_plan}", "--sample", "3", "--mass-factor", "1.2", "--set", "tracking.kp=3"],
        ["--set, mass_factor cannot be combined with sample"],
    ),
    (["track", "{a_plan}", "--set", "tracking.kp=-1"], ["with tracking.kp=-1: tracking.kp must be a number of at least 0"]),
    (
        ["track", "{a_plan}", "--set", "motion.duration_s=1"],
        ["a saved plan cannot be changed; only tracking.* and imperfections.*"],
    ),
    (["compare", "{a_plan}", "--delay-periods", "2000"], ["--delay-periods must be from 0 to 1000, got 2000"]),
    (["compare", "{a_plan}", "--mass-factor", "abc"], ["argument --mass-factor: takes a number, got 'abc'"]),
    (["compare", "{a_plan}", "--trackers"], ["argument --trackers: expected one argument"]),
    (["export", "{a_plan}", "--to", "csv", "-o"], ["argument -o"]),
    (["schema", "-o", "{a_file}"], ["exists and was not written by linkplan"]),
    (["track", "{truncated_plan}"], ["truncated"]),
    (["compare", "knee-reach", "--mass-factor", "0"], ["--mass-factor"]),
    (["compare", "knee-reach", "--set", "tracking.period_s=0.1"], ["period_s", "control instants"]),
    (["view", "knee-reach", "--slow", "0"], ["--slow"]),
    (["plan", "knee-reach", "-o", "{a_file}"], ["is a file"]),
]


@pytest.fixture(scope="module")
def places(tmp_path_factory):
    """Files that are wrong in their own ways."""
    folder = tmp_path_factory.mktemp("bad")
    contents = {
        "broken_toml": ("broken.toml", b"[motion\nkind = "),
        "binary": ("binary.toml", bytes(range(128, 256))),
        "empty": ("empty.xml", b""),
        "empty_toml": ("empty.toml", b""),
        "open_tree": ("open.xml", OPEN_TREE.encode()),
        "a_file": ("file.txt", b"hello"),
    }
    places = {}
    for name, (file, content) in contents.items():
        (folder / file).write_bytes(content)
        places[name] = str(folder / file)
    (folder / "empty_folder").mkdir()
    places["not_a_plan"] = str(folder / "empty_folder")
    truncated, whole = folder / "truncated", folder / "whole"
    assert main(["plan", "knee-reach", "-o", str(whole)]) == 0
    places["a_plan"] = str(whole)
    shutil.copytree(whole, truncated)
    content = (truncated / "trajectory.npz").read_bytes()
    (truncated / "trajectory.npz").write_bytes(content[: len(content) // 2])
    places["truncated_plan"] = str(truncated)
    return places


@pytest.mark.slow
@pytest.mark.parametrize(("argv", "words"), REFUSALS, ids=[" ".join(argv) for argv, _ in REFUSALS])
def test_bad_input_gets_one_line_and_exit_code_two(argv, words, places, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = [part.format(**places) if part.startswith("{") and part.endswith("}") else part for part in argv]
    if (
        "-o" not in arguments
        and arguments[0] in ("plan", "track", "compare", "check", "bode", "tune")
        and len(arguments) > 1
    ):
        arguments += ["-o", str(tmp_path / "result")]
    capsys.readouterr()
    code = main(arguments)
    out, err = capsys.readouterr()
    # Progress lines are indented; what is left is the refusal.
    refusal = [line for line in err.splitlines() if not line.startswith("  ")]
    assert code == 2, err
    assert out == ""
    assert len(refusal) == 1
    assert refusal[0].startswith("linkplan")
    for word in words:
        assert word in refusal[0]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "argv",
    [
        ["plan", "knee-reach", "--report"],
        ["plan", "knee-reach", "--parquet"],
        ["plan", "knee-reach", "--jumps"],
        ["batch", "sweep.toml", "--parquet"],
        ["compare", "knee-reach", "--parquet"],
    ],
)
def test_what_would_be_written_into_a_folder_asks_for_one(argv, capsys):
    assert main(argv) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert f"{argv[-1]} writes " in err
    assert "add -o DIR" in err
    assert len(err.splitlines()) == 1
