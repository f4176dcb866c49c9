"""The deadline of a computation: one object, passed to every loop that may take long. It counts processor time."""

import contextlib
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

from linkplan.models.errors import LinkplanError
from linkplan.models.interrupts import check

ItemT = TypeVar("ItemT")


class OutOfTimeError(LinkplanError):
    """The time of a computation ran out before it had an answer."""


class _Waited(threading.local):
    seconds = 0.0  # processor time of child processes that this thread waited for


_WAITED = _Waited()


def processor_time_s() -> float:
    """Return the processor time [s] of this thread, and of the child processes that it waited for."""
    return time.thread_time() + _WAITED.seconds


@contextlib.contextmanager
def waiting_for_child() -> Iterator[None]:
    """Count the processor time of a child process that is waited for inside as this thread's.

    Where the wait ends in an exception, as of a compiler that hangs, the whole wait counts: it would be as long again.
    """
    begin, before = time.monotonic(), os.times()
    try:
        yield
    except BaseException:
        _WAITED.seconds += time.monotonic() - begin
        raise
    after = os.times()
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    _WAITED.seconds += min(spent, time.monotonic() - begin)  # children of other threads may have ended meanwhile


@dataclass(frozen=True, slots=True, kw_only=True)
class Deadline:
    """An instant by which the thread that uses it is to be done: at `at_s` on `clock` [s]."""

    at_s: float = float("inf")
    clock: Callable[[], float] = processor_time_s

    @property
    def left_s(self) -> float:
        """The time left [s], negative afterwards."""
        return self.at_s - self.clock()

    @property
    def passed(self) -> bool:
        """True if no time is left."""
        return self.clock() > self.at_s

    def require_time(self) -> None:
        """Return where time is left, in a loop that has no answer before its end.

        Raises:
            OutOfTimeError: where none is.
            KeyboardInterrupt: where a signal asked this process to end.
        """
        check()
        if self.passed:
            raise OutOfTimeError("the computation ran out of its time")

    def take(self, items: Iterable[ItemT]) -> Iterator[ItemT]:
        """Yield items until the deadline has passed, be it while the next one is made."""
        with contextlib.suppress(OutOfTimeError):
            for item in items:
                yield item
                if self.passed:
                    break

    def within(self, seconds: float) -> "Deadline":
        """Return the deadline so many seconds from now, or this one where it is earlier."""
        return replace(self, at_s=min(self.at_s, self.clock() + seconds))

    def within_share(self, share: float) -> "Deadline":
        """Return the deadline after a share of the time left."""
        return self.within(share * self.left_s)

    def later_by(self, seconds: float) -> "Deadline":
        """Return the deadline so many seconds after this one."""
        return replace(self, at_s=self.at_s + seconds)


NO_DEADLINE = Deadline()
