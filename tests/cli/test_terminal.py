"""Terminals, pipes and streams: colours, progress, widths, and streams that are closed or cannot show a letter."""

import errno
import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from linkplan.cli.printing import Progress, put
from linkplan.planner.plan.folder import read_plan

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
    from linkplan.cli.main import main

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


FULL = Path("/dev/full")
needs_shell = pytest.mark.skipif(not FULL.exists(), reason="this system has no /dev/full")


def shell(line: str, folder: Path) -> tuple[int, str, str]:
    """Return exit code, stdout and stderr of a line of bash in a folder, in which L is linkplan."""
    script = f'L() {{ "{sys.executable}" -m linkplan "$@"; }}; set -o pipefail; {line}'
    done = subprocess.run(["bash", "-c", script], cwd=folder, capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr
    return done.returncode, done.stdout, done.stderr


@needs_shell
@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("L plan knee-reach -o P 2> /dev/full", 0),
        ("L plan knee-reach -o P <&- >&- 2>&-", 0),
        ("L plan knee-reach -o P --json | (exec <&-; sleep 0)", 141),
        ("L plan knee-reach -o P --json > /dev/full", 2),
    ],
)
def test_a_result_is_written_whatever_becomes_of_stdout_and_stderr(line, code, tmp_path):
    assert shell(line, tmp_path)[0] == code
    assert read_plan(tmp_path / "P").status == "optimal"


@needs_shell
@pytest.mark.slow
def test_progress_never_lands_in_the_json(tmp_path):
    code, out, _ = shell("L plan knee-reach --json 2>&-", tmp_path)
    assert code == 0
    assert json.loads(out)["status"] == "optimal"


@needs_shell
@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("L --version | (exec <&-)", 141),
        ("L list | (exec <&-)", 141),
        ("L list > /dev/full", 2),
        ("L --version >&-", 2),
        ("L --help > /dev/full", 2),
        ("L nonsense 2> /dev/full", 2),
        ("L nonsense 2>&-", 2),
        ("L 2>&-", 2),
    ],
)
def test_what_nobody_can_read_is_said_by_the_exit_code(line, code, tmp_path):
    # The pipe's reader is gone before the interpreter of the writer has begun.
    assert shell(line, tmp_path)[0] == code


@needs_shell
def test_a_lost_result_is_a_line_on_stderr(tmp_path):
    assert shell("L list > /dev/full", tmp_path)[2] == (
        "linkplan list: the result cannot be written: No space left on device\n"
    )
    assert shell("L list >&-", tmp_path)[2] == "linkplan list: stdout is closed\n"


def test_what_a_stream_has_no_characters_for_is_escaped():
    written = io.BytesIO()
    stream = io.TextIOWrapper(written, encoding="ascii")
    assert put(stream, "grün \udcff") is None
    assert written.getvalue() == rb"gr\xfcn \udcff"


class Small(io.RawIOBase):
    """A file that takes a thousand bytes at once, on a disk with room for a number of bytes."""

    def __init__(self, room: int) -> None:
        self.room, self.taken = room, b""

    def writable(self) -> bool:
        return True

    def write(self, content) -> int:
        taken = bytes(content)[: min(1000, self.room - len(self.taken))]
        if content and not taken:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self.taken += taken
        return len(taken)


def test_an_unbuffered_stream_gets_the_whole_text_or_the_error():
    for room, error in ((5000, None), (4096, errno.ENOSPC)):
        small = Small(room)
        lost = put(io.TextIOWrapper(small, encoding="utf-8", write_through=True), "x" * 5000)
        assert (lost and lost.errno) == error
        assert len(small.taken) == room


def test_a_stream_that_was_closed_is_an_error_and_raises_nothing():
    stream = io.StringIO()
    stream.close()
    assert put(stream, "text").errno == errno.EBADF
    assert put(None, "text").errno == errno.EBADF
