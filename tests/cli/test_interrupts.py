"""Signals, and what a process finds around it: limits, settings of matplotlib, little memory."""

import os
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import matplotlib
import pytest

from linkplan.cli import commands, exit_codes
from linkplan.cli import main as program
from linkplan.models.deadline import ended_by
from linkplan.planner.plan.folder import read_plan
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.studies.output.figure import page
from tests.support.plans import optimal

pytestmark = [
    pytest.mark.skipif(os.name != "posix", reason="signals are sent as POSIX has them"),
    pytest.mark.usefixtures("default_signals"),
]
CODES = {signal.SIGINT: 130, signal.SIGTERM: 143}


@pytest.mark.parametrize("number", CODES)
def test_a_signal_while_planning_ends_the_command_and_writes_nothing(number, ask, tmp_path, monkeypatch):
    def ended(problem: Problem, _: object) -> Plan:
        os.kill(os.getpid(), number)
        return optimal(problem.name)

    monkeypatch.setattr("linkplan.api.plans.plan_motion", ended)
    code, out, err = ask("plan", "knee-reach", "-o", str(tmp_path / "P"))
    assert (code, out) == (CODES[number], "")
    assert err == "linkplan plan: interrupted; nothing was written\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", CODES)
def test_a_signal_after_the_result_was_written_says_where_it_is(number, ask, tmp_path, monkeypatch):
    monkeypatch.setattr("linkplan.api.plans.plan_motion", lambda problem, _: optimal(problem.name))
    monkeypatch.setattr(commands, "show", lambda *_: os.kill(os.getpid(), number))
    place = tmp_path / "P"
    code, _, err = ask("plan", "knee-reach", "-o", str(place))
    assert code == CODES[number]
    assert err.endswith(f"linkplan plan: interrupted; the complete result is in '{place}'\n")
    assert read_plan(place).status == "optimal"


def test_what_a_library_makes_of_an_interrupt_is_an_interrupt(ask, monkeypatch):
    def loads(_: object) -> int:
        try:
            os.kill(os.getpid(), signal.SIGINT)
        except KeyboardInterrupt as error:
            raise ImportError("initialization failed") from error
        return 0

    monkeypatch.setattr(commands, "run_plan", loads)
    code, _, err = ask("plan", "knee-reach")
    assert code == 130
    assert err == "linkplan plan: interrupted; nothing was written\n"


EARLY = """
import os, sys
import linkplan.__main__ as entry
assert "linkplan.cli.main" not in sys.modules  # nothing that takes time is loaded before signals are heard

class Sends:
    def find_spec(self, name, *_):
        if name == "linkplan.cli.main":
            os.kill(os.getpid(), {number})

sys.meta_path.insert(0, Sends())
sys.argv = ["linkplan", "list"]
sys.exit(entry.main())
"""


@pytest.mark.parametrize("number", [*CODES, signal.SIGHUP])
def test_a_signal_while_the_program_is_loaded_is_heard(number):
    run = [sys.executable, "-c", EARLY.format(number=int(number))]
    ended = subprocess.run(run, capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stdout) == (128 + number, "")
    assert ended.stderr == "linkplan: interrupted; nothing was written\n"


def test_a_signal_that_is_ignored_while_the_program_is_loaded_stays_ignored():
    ignoring = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN)\n" + EARLY.format(number=int(signal.SIGTERM))
    ended = subprocess.run([sys.executable, "-c", ignoring], capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert "optimus-knee" in ended.stdout


def test_the_script_and_the_module_are_the_same_entry():
    said = tomllib.loads((Path(__file__).resolve().parents[2] / "pyproject.toml").read_text(encoding="utf-8"))
    assert said["project"]["scripts"] == {"linkplan": "linkplan.__main__:main"}


def test_handlers_are_as_they_were_after_a_command(ask):
    before = {number: signal.getsignal(number) for number in (*CODES, signal.SIGALRM)}
    assert ask("list")[0] == 0
    assert {number: signal.getsignal(number) for number in before} == before
    assert ended_by() is None


def test_figures_do_not_take_over_settings_of_the_readers(tmp_path):
    with matplotlib.rc_context({"savefig.dpi": 3000, "text.usetex": True, "figure.dpi": 3000}):
        with page(tmp_path / "figure.png") as axes:
            axes[0, 0].set_title("speed")
        assert matplotlib.rcParams["savefig.dpi"] == 3000  # and leave them as they were
    assert (tmp_path / "figure.png").stat().st_size < 200_000


@pytest.mark.filterwarnings("error")
def test_a_letter_that_the_font_has_not_is_no_warning(tmp_path):
    with page(tmp_path / "figure.png") as axes:
        axes[0, 0].set_title("\U0001f9bf")
    assert (tmp_path / "figure.png").is_file()


@pytest.mark.slow
def test_a_check_is_drawn_whatever_matplotlib_is_set_to(tmp_path):
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\nsavefig.dpi: 30000\n")
    words = [sys.executable, "-m", "linkplan", "check", "optimus-knee", "-o", "out"]
    done = subprocess.run(words, cwd=tmp_path, env=os.environ | {"MPLBACKEND": "nonsense"}, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "mechanism.png").is_file()


@pytest.mark.parametrize(
    "error",
    [MemoryError(), OSError(12, "Cannot allocate memory"), ImportError("x.so: failed to map segment from shared object")],
)
def test_memory_that_there_is_not_is_named_whatever_kind_of_error_says_so(error):
    assert "not enough memory" in exit_codes.saved_fault_report(error)


def test_an_error_that_cannot_even_be_told_is_a_line(monkeypatch, capsys):
    def fails(_: BaseException) -> str:
        raise MemoryError

    monkeypatch.setattr(program, "saved_fault_report", fails)
    assert program.unforeseen("plan", RuntimeError("x")) == 2
    assert capsys.readouterr().err == "linkplan plan: not enough memory\n"


def test_what_cannot_be_read_is_not_said_to_be_unwritable(monkeypatch, capsys):
    def fails(_: object) -> int:
        raise PermissionError(13, "Permission denied", "planned/plan.json")

    monkeypatch.setattr("linkplan.cli.commands.run_list", fails)
    assert program.main(["list"]) == 2
    assert capsys.readouterr().err == "linkplan list: 'planned/plan.json' cannot be read or written: Permission denied\n"


@pytest.mark.parametrize("text", ["abc", "", "1e5", "9" * 20])
def test_a_date_of_the_surroundings_that_is_none_is_refused_in_one_line(text, monkeypatch, capsys):
    """NumPy, SciPy and matplotlib read it when they are loaded, and fail."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", text)
    assert program.main(["list"]) == 2
    said = capsys.readouterr().err
    assert "SOURCE_DATE_EPOCH must be a time in whole seconds since 1970" in said
    assert len(said.splitlines()) == 1


def test_a_date_of_the_surroundings_is_no_hindrance(monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "315532800")
    assert program.main(["list"]) == 0
