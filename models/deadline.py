"""What long computations share: a deadline in processor time, Ctrl-C and SIGTERM, and one lock of the process.

A KeyboardInterrupt during CasADi's conversion of a number is swallowed, becomes a SystemError or ends the process. While
`listening`, the first signal therefore sets a flag. KeyboardInterrupt is raised at once if no frame of CasADi and no
destructor is on the stack and nothing is `shielded`. Otherwise `check` raises it later, and the solver's callback reads the
flag. A second Ctrl-C ends the process at once. This loses no file, because files are written whole or not at all.
"""

import contextlib
import functools
import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from types import FrameType
from typing import ParamSpec, TypeVar

from linkplan.models.errors import LinkplanError

ONE_THREAD = threading.RLock()
Asked = ParamSpec("Asked")
Answer = TypeVar("Answer")
_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


def one_thread_at_a_time(function: Callable[Asked, Answer]) -> Callable[Asked, Answer]:
    """Return a function that waits until no other thread is in it, or in any other function with this decorator.

    Its calls may be nested. Three libraries need it: CasADi 3.8 gives up Python's own lock in symbolic calls while it enters
    their constants in one table of the process; msgspec 0.22 prepares a type at its first conversion; and MuJoCo's warnings
    become Python warnings, whose filters belong to the process.
    """

    @functools.wraps(function)
    def alone(*args: Asked.args, **kwargs: Asked.kwargs) -> Answer:
        with ONE_THREAD:
            return function(*args, **kwargs)

    return alone


class _State:
    """The state of the signal handlers of this process."""

    asked: int | None = None  # the number of the signal received
    is_read = False  # true while signals set the flag
    shields = 0  # number of active `shielded` blocks


def asked() -> int | None:
    """Return the number of the signal that asks this process to end, or None. It is None in threads other than the main."""
    return _State.asked if _State.is_read and threading.current_thread() is threading.main_thread() else None


def ended_by() -> int | None:
    """Return the number of the signal received in the last `listening` or `solving` block, or None."""
    return _State.asked


def check() -> None:
    """Raise KeyboardInterrupt if a signal has asked this process to end, unless a `shielded` block is active."""
    if asked() is not None and not _State.shields:
        raise KeyboardInterrupt


@contextlib.contextmanager
def shielded() -> Iterator[None]:
    """Delay the KeyboardInterrupt of a signal until the end of the block. Only effective while `listening`."""
    _State.shields += 1
    try:
        yield
    finally:
        _State.shields -= 1
    check()


@contextlib.contextmanager
def listening(*, to_the_end: bool = False) -> Iterator[None]:
    """Handle signals that ask this process to end.

    Args:
        to_the_end: True if the process ends after the block. Signals are then ignored instead of handled as before.
    """
    if threading.current_thread() is not threading.main_thread() or _State.is_read:
        yield
        return
    # Ignored signals stay ignored: nohup, and background jobs of a shell without job control.
    handled = {number: before for number in _SIGNALS if (before := signal.getsignal(number)) is not signal.SIG_IGN}
    _State.asked, _State.is_read = None, True
    for number in handled:
        signal.signal(number, _remember_and_raise)
    try:
        yield
    finally:
        _State.is_read = False
        for number, before in handled.items():
            signal.signal(number, signal.SIG_IGN if to_the_end else signal.SIG_DFL if before is None else before)


@contextlib.contextmanager
def solving() -> Iterator[None]:
    """Let a signal stop the block's solver, whose callback reads `asked`, and raise KeyboardInterrupt at the block's end.

    Outside of `listening` (in a user's program) only Ctrl-C is handled, and the user's own handler is called after the
    solver has stopped.
    """
    if _State.is_read or threading.current_thread() is not threading.main_thread():
        yield
        check()
        return
    before = signal.getsignal(signal.SIGINT)
    if before in (signal.SIG_IGN, None):
        yield
        return
    _State.asked, _State.is_read = None, True
    signal.signal(signal.SIGINT, _remember)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        _State.is_read = False
    if _State.asked is not None:
        if callable(before):
            before(signal.SIGINT, None)
        raise KeyboardInterrupt


def _remember(number: int, frame: FrameType | None) -> None:
    del frame
    _State.asked = number


def _remember_and_raise(number: int, frame: FrameType | None) -> None:
    if not _State.is_read:
        return
    if _State.asked is None:
        _State.asked = number
        if not _State.shields and can_raise(frame):
            raise KeyboardInterrupt
    elif number == signal.SIGINT and not _State.shields:
        os._exit(128 + _State.asked)


def can_raise(frame: FrameType | None) -> bool:
    """Return True if an exception in a frame reaches its callers: no CasADi frame and no destructor is on the stack."""
    while frame is not None:
        if frame.f_code.co_name == "__del__" or frame.f_globals.get("__name__", "").partition(".")[0] == "casadi":
            return False
        frame = frame.f_back
    return True


ItemT = TypeVar("ItemT")


class OutOfTimeError(LinkplanError):
    """The deadline passed before the computation had a result."""


class _ChildTime(threading.local):
    seconds = 0.0  # processor time of child processes that this thread waited for


_CHILD_TIME = _ChildTime()


def processor_time_s() -> float:
    """Return the processor time [s] of this thread, and of the child processes that it waited for."""
    return time.thread_time() + _CHILD_TIME.seconds


@contextlib.contextmanager
def waiting_for_child() -> Iterator[None]:
    """Add the processor time of a child process that the block waits for to this thread's time.

    If the wait ends in an exception (a compiler hangs), the whole wall time of the wait counts.
    """
    begin, before = time.monotonic(), os.times()
    try:
        yield
    except BaseException:
        _CHILD_TIME.seconds += time.monotonic() - begin
        raise
    after = os.times()
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    _CHILD_TIME.seconds += min(spent, time.monotonic() - begin)  # children of other threads may have ended meanwhile


@dataclass(frozen=True, slots=True, kw_only=True)
class Deadline:
    """The instant `at_s` [s] of `clock` at which a computation in this thread has to end."""

    at_s: float = float("inf")
    clock: Callable[[], float] = processor_time_s

    @property
    def left_s(self) -> float:
        """The remaining time [s], negative after the deadline."""
        return self.at_s - self.clock()

    @property
    def passed(self) -> bool:
        """True if no time is left."""
        return self.clock() > self.at_s

    def require_time(self) -> None:
        """Check the deadline in a loop that has no partial result.

        Raises:
            OutOfTimeError: if the deadline has passed.
            KeyboardInterrupt: if a signal asked this process to end.
        """
        check()
        if self.passed:
            raise OutOfTimeError("the computation ran out of its time")

    def take(self, items: Iterable[ItemT]) -> Iterator[ItemT]:
        """Yield items until the deadline has passed, also if it passes while the next item is computed."""
        with contextlib.suppress(OutOfTimeError):
            for item in items:
                yield item
                if self.passed:
                    break

    def within(self, seconds: float) -> "Deadline":
        """Return the deadline in `seconds` from now, or this deadline if it is earlier."""
        return replace(self, at_s=min(self.at_s, self.clock() + seconds))

    def within_share(self, share: float) -> "Deadline":
        """Return the deadline after a share of the remaining time."""
        return self.within(share * self.left_s)

    def later_by(self, seconds: float) -> "Deadline":
        """Return the deadline `seconds` after this one."""
        return replace(self, at_s=self.at_s + seconds)


NO_DEADLINE = Deadline()
