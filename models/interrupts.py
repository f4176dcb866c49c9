"""Ctrl-C and SIGTERM: a flag that loops and solvers read, and an exception only where one can be raised safely.

A KeyboardInterrupt that Python raises while CasADi converts a number is swallowed, turned into a SystemError or ends the
process. While `listening`, the first signal therefore sets a flag. It is raised as KeyboardInterrupt at once where no frame
of CasADi and no destructor is being run and nothing is `shielded`; otherwise `check` raises it later, and the solver's
callback reads it. A second Ctrl-C ends the process at once: what it writes is whole at every instant.
"""

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from types import FrameType

_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class _State:
    """What has been asked of this process; there is one, as there is one set of signal handlers."""

    asked: int | None = None  # the signal's number
    is_read = False  # whether signals set the flag now
    shields = 0


def asked() -> int | None:
    """Return the number of the signal that asks this process to end, or None; None in threads, which hear no signals."""
    return _State.asked if _State.is_read and threading.current_thread() is threading.main_thread() else None


def ended_by() -> int | None:
    """Return the number of the signal that came while signals were last listened to, or None."""
    return _State.asked


def check() -> None:
    """Raise KeyboardInterrupt where a signal has asked this process to end, unless it is held back."""
    if asked() is not None and not _State.shields:
        raise KeyboardInterrupt


@contextlib.contextmanager
def shielded() -> Iterator[None]:
    """Hold signals back until what is inside is done. Only those that are listened to can be held back."""
    _State.shields += 1
    try:
        yield
    finally:
        _State.shields -= 1
    check()


@contextlib.contextmanager
def listening(*, to_the_end: bool = False) -> Iterator[None]:
    """Listen to signals that ask this process to end.

    Args:
        to_the_end: whether the process ends afterwards: signals are then ignored from there on, not handled as before.
    """
    if threading.current_thread() is not threading.main_thread() or _State.is_read:
        yield
        return
    # What was ignored stays ignored: nohup, and jobs in the background of a shell without job control.
    heard = {number: before for number in _SIGNALS if (before := signal.getsignal(number)) is not signal.SIG_IGN}
    _State.asked, _State.is_read = None, True
    for number in heard:
        signal.signal(number, _remember_and_raise)
    try:
        yield
    finally:
        _State.is_read = False  # from here on nothing is raised
        for number, before in heard.items():
            signal.signal(number, signal.SIG_IGN if to_the_end else signal.SIG_DFL if before is None else before)


@contextlib.contextmanager
def solving() -> Iterator[None]:
    """Let a signal stop the solver that is run inside, which reads `asked`, and raise KeyboardInterrupt when it has stopped.

    Outside of `listening` (in a program of the user's) that holds for Ctrl-C, and the user's own handler is called after
    the solver has stopped.
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
    """Return True if an exception raised in a frame reaches its callers: not through CasADi, nor from a destructor."""
    while frame is not None:
        if frame.f_code.co_name == "__del__" or frame.f_globals.get("__name__", "").partition(".")[0] == "casadi":
            return False
        frame = frame.f_back
    return True
