"""Signals and deadlines inside the solver and in other libraries."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable

import casadi as ca
import pytest

from linkplan.models.deadline import (
    NO_DEADLINE,
    Deadline,
    OutOfTimeError,
    asked,
    check,
    ended_by,
    listening,
    processor_time_s,
    shielded,
    waiting_for_child,
)
from linkplan.models.errors import LinkplanError
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


def work(seconds: float) -> None:
    """Use so much processor time of this thread."""
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        sum(range(1000))


def counting() -> Deadline:
    """Return a deadline whose clock goes on by one second each time that it is read."""
    reads = iter(range(1_000_000))
    return Deadline(clock=lambda: float(next(reads)))


def test_without_a_deadline_there_is_always_time():
    NO_DEADLINE.require_time()
    assert not NO_DEADLINE.passed
    assert NO_DEADLINE.within_share(0.5) == NO_DEADLINE


def test_a_loop_without_an_answer_ends_in_one_error_of_ours():
    late = Deadline().within(-1.0)
    assert late.passed
    assert late.left_s < 0
    with pytest.raises(OutOfTimeError):
        late.require_time()
    assert issubclass(OutOfTimeError, LinkplanError)


def test_the_earlier_of_two_deadlines_holds():
    soon = Deadline(clock=lambda: 10.0).within(5.0)
    assert soon.at_s == 15.0
    assert soon.within(9.0).at_s == 15.0
    assert soon.within(2.0).at_s == 12.0
    assert soon.within_share(0.2).at_s == 11.0
    assert soon.later_by(3.0).at_s == 18.0


def test_items_end_with_the_time_also_while_one_is_made():
    def made(deadline):
        for item in range(100):
            deadline.require_time()
            yield item

    between = counting().within(5.0)
    assert 1 < len(list(between.take(range(100)))) < 10
    while_made = counting().within(5.0)
    assert 1 < len(list(while_made.take(made(while_made)))) < 10


def test_threads_do_not_share_their_time():
    begin = processor_time_s()
    other = threading.Thread(target=work, args=(0.3,))
    other.start()
    other.join()
    assert processor_time_s() - begin < 0.2


def test_a_child_that_is_waited_for_counts_in_the_thread_that_waits():
    spin = "import time\nwhile time.process_time() < 0.4: pass"  # a child's time is known to some hundredths of a second
    begin, own, of_another = processor_time_s(), time.thread_time(), []
    with waiting_for_child():
        subprocess.run([sys.executable, "-c", spin], check=True)
    other = threading.Thread(target=lambda: of_another.append(processor_time_s() - time.thread_time()))
    other.start()
    other.join()
    assert processor_time_s() - begin - (time.thread_time() - own) >= 0.3
    assert of_another[0] < 0.01


def test_the_whole_wait_for_a_child_that_hangs_counts():
    begin = processor_time_s()
    with pytest.raises(subprocess.TimeoutExpired), waiting_for_child():
        subprocess.run([sys.executable, "-c", "import time; time.sleep(60)"], check=True, timeout=0.3)
    assert processor_time_s() - begin >= 0.3
