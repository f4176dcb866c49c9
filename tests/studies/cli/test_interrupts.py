"""Ctrl-C and SIGTERM on the command line: the exit code is the signal's, and what is said of the result is true."""

import os
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from linkplan.models.deadline import ended_by
from linkplan.planner.plan.folder import read_plan
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.studies.cli import commands
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

    monkeypatch.setattr("linkplan.plans.plan_motion", ended)
    code, out, err = ask("plan", "knee-reach", "-o", str(tmp_path / "P"))
    assert (code, out) == (CODES[number], "")
    assert err == "linkplan plan: interrupted; nothing was written\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", CODES)
def test_a_signal_after_the_result_was_written_says_where_it_is(number, ask, tmp_path, monkeypatch):
    monkeypatch.setattr("linkplan.plans.plan_motion", lambda problem, _: optimal(problem.name))
    monkeypatch.setattr(commands, "show", lambda *_: os.kill(os.getpid(), number))
    place = tmp_path / "P"
    code, _, err = ask("plan", "knee-reach", "-o", str(place))
    assert code == CODES[number]
    assert err.endswith(f"linkplan plan: interrupted; the result is in '{place}', whole\n")
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
assert "linkplan.studies.cli.main" not in sys.modules  # nothing that takes time is loaded before signals are heard

class Sends:
    def find_spec(self, name, *_):
        if name == "linkplan.studies.cli.main":
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
    said = tomllib.loads((Path(__file__).resolve().parents[3] / "pyproject.toml").read_text(encoding="utf-8"))
    assert said["project"]["scripts"] == {"linkplan": "linkplan.__main__:main"}


def test_handlers_are_as_they_were_after_a_command(ask):
    before = {number: signal.getsignal(number) for number in (*CODES, signal.SIGALRM)}
    assert ask("list")[0] == 0
    assert {number: signal.getsignal(number) for number in before} == before
    assert ended_by() is None
