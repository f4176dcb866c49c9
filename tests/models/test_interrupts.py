"""Signals: a flag that solvers and loops read, raised only where an exception can pass, and held back where it may not."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable

import casadi as ca
import pytest

from linkplan.models.deadline import asked, check, ended_by, listening, shielded
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.solvers import solve

pytestmark = [
    pytest.mark.skipif(os.name != "posix", reason="signals are sent as POSIX has them"),
    pytest.mark.usefixtures("default_signals"),
]


def send(number: int = signal.SIGINT) -> None:
    os.kill(os.getpid(), number)


def interrupted(run: Callable[[], object]) -> int | None:
    """Return the signal that ended a function which was listened in; none where it went on to its end."""
    try:
        with listening():
            run()
            check()
    except KeyboardInterrupt:
        return ended_by()
    return None


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_is_listened_to_is_raised_and_remembered_and_then_over(number):
    before = signal.getsignal(number)
    assert interrupted(lambda: send(number)) == number
    assert signal.getsignal(number) == before
    assert asked() is None
    check()


def test_these_tests_hear_signals_that_the_process_was_begun_without():
    ignored = "signal.signal(signal.SIGINT, signal.SIG_IGN), signal.signal(signal.SIGHUP, signal.SIG_IGN)"
    these = f"{__file__}::test_a_signal_that_is_listened_to_is_raised_and_remembered_and_then_over"
    words = [
        sys.executable,
        "-c",
        f"import signal, sys, pytest; {ignored}; sys.exit(pytest.main(sys.argv[1:]))",
        "-p",
        "no:xdist",
        these,
    ]
    assert subprocess.run(words, capture_output=True, text=True, check=False).returncode == 0


def test_a_signal_is_held_back_by_a_shield_and_raised_behind_it():
    done = []

    def run() -> None:
        with shielded():
            send()
            done.append("inside")
        done.append("behind")

    assert interrupted(run) == signal.SIGINT
    assert done == ["inside"]


class Sends:
    """An array that asks for an end while CasADi converts it."""

    converted = False

    def __DM__(self) -> ca.DM:  # noqa: N802  (CasADi asks for it)
        if not self.converted:  # CasADi converts it more than once
            send()
        self.converted = True
        return ca.DM.ones(3)


def test_a_signal_in_casadi_s_conversion_is_neither_swallowed_nor_a_system_error():
    array = Sends()
    assert interrupted(lambda: ca.DM(array)) == signal.SIGINT
    assert array.converted  # the conversion itself went on


class Calls(ca.Callback):
    """A function of CasADi's that asks for an end."""

    def __init__(self) -> None:
        ca.Callback.__init__(self)
        self.went_on = False
        self.construct("calls", {})

    def eval(self, arg: list) -> list:
        if not self.went_on:
            send()
        self.went_on = True
        return arg


def test_a_signal_in_a_callback_does_not_go_through_casadi():
    function = Calls()
    assert interrupted(lambda: function(2.0)) == signal.SIGINT
    assert function.went_on


def third_read(monkeypatch, room: object, *, ends: bool) -> list:
    """Return the list of a solver's reads of the flag; before the third the signal is sent, where it `ends` it."""
    reads: list = []

    def read() -> int | None:
        reads.append(len(reads))
        if ends and len(reads) == 3:
            send()
        return asked()

    monkeypatch.setattr(room, "asked", read)
    return reads


def test_a_signal_stops_the_solver(monkeypatch):
    problem = load_problem("knee-reach")
    reads = third_read(monkeypatch, solve, ends=False)
    assert interrupted(lambda: plan_motion(problem)) is None
    assert len(reads) > 5  # without a signal it would go on
    reads = third_read(monkeypatch, solve, ends=True)
    assert interrupted(lambda: plan_motion(problem)) == signal.SIGINT
    assert len(reads) == 3


def test_in_a_program_of_the_users_their_handler_is_called_when_the_solver_has_stopped(monkeypatch):
    heard: list = []
    before = signal.signal(signal.SIGINT, lambda number, _: heard.append(number))
    reads = third_read(monkeypatch, solve, ends=True)
    try:
        with pytest.raises(KeyboardInterrupt):
            plan_motion(load_problem("knee-reach"))
    finally:
        signal.signal(signal.SIGINT, before)
    assert heard == [signal.SIGINT]
    assert len(reads) == 3


TWICE = """
import os, signal
from linkplan.models.deadline import listening

with listening():
    try:
        os.kill(os.getpid(), signal.{first})
    finally:
        os.kill(os.getpid(), signal.{second})
        print("in order", flush=True)
        os._exit(0)
"""


@pytest.mark.parametrize(
    ("first", "second", "code", "printed"),
    [("SIGINT", "SIGINT", 130, ""), ("SIGTERM", "SIGINT", 143, ""), ("SIGTERM", "SIGTERM", 0, "in order\n")],
)
def test_a_second_interrupt_ends_the_process_at_once_and_another_signal_does_not(first, second, code, printed):
    run = [sys.executable, "-c", TWICE.format(first=first, second=second)]
    ended = subprocess.run(run, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (code, printed)
