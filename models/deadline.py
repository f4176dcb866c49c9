"""The deadline of a computation in processor time. Every loop that may take long receives it."""

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
