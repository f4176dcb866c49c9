"""Ctrl-C and SIGTERM on the command line: the exit code is the signal's, and what is said of the result is true."""

import os
import signal

import pytest

from linkplan.models.interrupts import ended_by
from linkplan.planner.files.plan_folder import read_plan
from linkplan.planner.plan import Plan
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.studies.cli import plan_commands
from tests.support.plans import optimal

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals are sent as POSIX has them")
CODES = {signal.SIGINT: 130, signal.SIGTERM: 143}


@pytest.mark.parametrize("number", CODES)
def test_a_signal_while_planning_ends_the_command_and_writes_nothing(number, ask, tmp_path, monkeypatch):
    def ended(problem: PlanningProblem, _: object) -> Plan:
        os.kill(os.getpid(), number)
        return optimal(problem.name)

    monkeypatch.setattr(plan_commands, "plan_motion", ended)
    code, out, err = ask("plan", "knee-reach", "-o", str(tmp_path / "P"))
    assert (code, out) == (CODES[number], "")
    assert err == "linkplan plan: interrupted; nothing was written\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", CODES)
def test_a_signal_after_the_result_was_written_says_where_it_is(number, ask, tmp_path, monkeypatch):
    monkeypatch.setattr(plan_commands, "plan_motion", lambda problem, _: optimal(problem.name))
    monkeypatch.setattr(plan_commands, "show", lambda *_: os.kill(os.getpid(), number))
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

    monkeypatch.setattr(plan_commands, "run_plan", loads)
    code, _, err = ask("plan", "knee-reach")
    assert code == 130
    assert err == "linkplan plan: interrupted; nothing was written\n"


def test_handlers_are_as_they_were_after_a_command(ask):
    before = {number: signal.getsignal(number) for number in (*CODES, signal.SIGALRM)}
    assert ask("list")[0] == 0
    assert {number: signal.getsignal(number) for number in before} == before
    assert ended_by() is None
