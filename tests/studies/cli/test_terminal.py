"""What a terminal gets that a pipe does not: colours, a line that is rewritten, sentences at its own width."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from linkplan.studies.cli.printing import Progress

pty = pytest.importorskip("pty")
SEQUENCE = re.compile(r"\x1b\[[0-9;]*[A-Za-z]")


def on_a_terminal(*argv: str, columns: int = 100, **environment: str) -> tuple[int, str]:
    """Run a command on a terminal of its own; return its exit code and what was written there."""
    import fcntl
    import struct
    import termios

    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    plain = {key: value for key, value in os.environ.items() if key not in ("NO_COLOR", "COLUMNS")}
    command = [sys.executable, "-m", "linkplan", *argv]
    running = subprocess.Popen(
        command, stdin=theirs, stdout=theirs, stderr=theirs, env=plain | {"TERM": "xterm"} | environment
    )
    os.close(theirs)
    said = b""
    while True:
        try:
            chunk = os.read(ours, 65536)
        except OSError:
            break
        if not chunk:
            break
        said += chunk
    os.close(ours)
    return running.wait(), said.decode("utf-8").replace("\r\n", "\n")


@pytest.mark.slow
def test_progress_is_one_line_that_is_rewritten_and_gone_before_what_stays_and_the_result(tmp_path):
    code, said = on_a_terminal("plan", "knee-reach", "-o", str(tmp_path / "planned"), columns=200)
    assert code == 0
    before, _, result = said.partition("knee-reach: optimal")
    assert "first solve" in before
    assert re.search(r"  plan +[0-9.]+ s: saved in [^\n]*planned\n", before)
    assert before.count("\n") == 2  # of what stays; progress is erased from below
    assert before.endswith("\x1b[32m")
    assert "certificate: passed" in result
    assert "first solve" not in result


def test_a_name_with_control_characters_cannot_write_on_the_terminal(capsys):
    Progress("plan").keep("saved in a\x1b[2J\nb")
    assert capsys.readouterr().err.endswith(r"saved in a\x1b[2J\nb" + "\n")


@pytest.mark.parametrize("environment", [{"NO_COLOR": "1"}, {"TERM": "dumb"}, {"TERM": ""}])
def test_colours_can_be_refused(environment):
    code, said = on_a_terminal("plan", "no-such-problem", **environment)
    assert code == 2
    assert not SEQUENCE.search(said)
    assert said.startswith("linkplan plan: unknown problem")


def test_a_refusal_is_coloured_on_a_terminal_and_plain_in_a_pipe():
    assert on_a_terminal("plan", "no-such-problem")[1].startswith("\x1b[31mlinkplan plan\x1b[0m: unknown problem")
    piped = subprocess.run(
        [sys.executable, "-m", "linkplan", "plan", "no-such"], capture_output=True, text=True, check=False
    )
    assert "\x1b" not in piped.stderr


@pytest.mark.slow
def test_a_dumb_terminal_has_plain_lines_of_progress():
    _, said = on_a_terminal("plan", "knee-reach", TERM="dumb")
    assert not SEQUENCE.search(said)
    assert re.search(r"^  plan +[0-9.]+ s: first solve[^\n]*\n", said)


def test_a_narrow_terminal_has_every_name_within_its_width_and_a_pipe_has_no_sequences():
    _, said = on_a_terminal("list", columns=60)
    bare = SEQUENCE.sub("", said)
    assert max(map(len, bare.splitlines())) <= 60
    piped = subprocess.run([sys.executable, "-m", "linkplan", "list"], capture_output=True, text=True, check=True).stdout
    assert not SEQUENCE.search(piped)
    assert max(map(len, piped.splitlines())) > 80
    assert set(re.findall(r"[\w-]+", piped)) - set(re.findall(r"[\w-]+", bare)) <= {"-" * k for k in range(200)}


@pytest.mark.parametrize("command", ["list", "check", "plan", "batch", "bode", "tune", "new", "export", "completion"])
def test_help_fits_eighty_columns(command, capsys, monkeypatch):
    from linkplan.studies.cli.main import main

    monkeypatch.setenv("COLUMNS", "80")
    assert main([command, "--help"]) == 0
    assert max(map(len, capsys.readouterr().out.splitlines())) <= 80


def test_every_table_of_check_fits_where_there_are_many_freedoms(tmp_path):
    bodies = "".join(
        f'<body pos="0.1 0 0"><joint name="a_rather_long_name_{k}" axis="0 1 0" range="-90 90"/><geom size="0.02"/>'
        for k in range(8)
    )
    motors = "".join(f'<motor name="drive_{k}" joint="a_rather_long_name_{k}" ctrlrange="-9 9"/>' for k in range(8))
    model = Path(tmp_path / "arm.xml")
    text = f"<mujoco><worldbody>{bodies}{'</body>' * 8}</worldbody><actuator>{motors}</actuator>"
    model.write_text(f"{text}<option><flag contact='disable'/></option></mujoco>", encoding="utf-8")
    _, said = on_a_terminal("check", str(model), "--all", columns=80)
    lines = SEQUENCE.sub("", said).splitlines()
    assert max(map(len, lines)) <= 80
    assert len([line for line in lines if "  " in line.strip()]) > 20
