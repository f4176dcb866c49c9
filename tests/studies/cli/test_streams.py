"""What is printed may fail; a result may not: pipes that break, streams that are closed, disks that are full."""

import errno
import io
import json
import subprocess
import sys
from pathlib import Path

import pytest

from linkplan.planner.plan.folder import read_plan
from linkplan.studies.cli.printing import put

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


def test_a_stream_that_was_closed_is_an_error_and_raises_nothing():
    stream = io.StringIO()
    stream.close()
    assert put(stream, "text").errno == errno.EBADF
    assert put(None, "text").errno == errno.EBADF
