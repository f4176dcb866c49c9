"""Ctrl-C and SIGTERM: a flag that loops and solvers read, and an exception only where one can be raised safely.

A KeyboardInterrupt that Python raises while CasADi converts a number is swallowed, turned into a SystemError or ends the
process. While `listening`, a signal therefore sets a flag. `check` reads it, as does the solver's callback; beside
them the flag is raised as KeyboardInterrupt as soon as no frame of CasADi and no destructor is being run, and again
until somebody ends the command. `shielded` holds it back while files change places.
"""

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from types import FrameType

# How long after a signal that could not be raised it is tried again, and after one that was and led to nothing [s].
_SOON_S, _LATER_S = 0.02, 1.0
# Asked this often, a process that is deep in native code ends at once: what it writes is whole at every instant.
_AT_ONCE = 3
_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class _State:
    """What has been asked of this process; there is one, as there is one set of signal handlers."""

    asked: int | None = None  # the signal's number
    last: int | None = None  # of the last listening
    times = 0
    listening = False
    shields = 0


def asked() -> int | None:
    """Return the number of the signal that asks this process to end, or None; None in threads, which hear no signals."""
    return _State.asked if threading.current_thread() is threading.main_thread() else None


def ended_by() -> int | None:
    """Return the number of the signal that came while it was last listened to, or None."""
    # An interrupt raised just where listening ends leaves it where it was.
    return _State.asked if _State.last is None else _State.last


def check() -> None:
    """Raise KeyboardInterrupt where a signal has asked this process to end, unless it is held back."""
    if asked() is not None and not _State.shields:
        if _State.listening and hasattr(signal, "setitimer"):
            # Not again at once: what is to be put in order on the way out must first be reached.
            signal.setitimer(signal.ITIMER_REAL, _LATER_S)
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
    if threading.current_thread() is not threading.main_thread() or _State.listening:
        yield
        return
    _State.asked, _State.last, _State.times, _State.listening = None, None, 0, True
    before = {number: signal.getsignal(number) for number in _SIGNALS}
    # What was ignored stays ignored: nohup, and jobs in the background of a shell without job control.
    heard = [number for number, handler in before.items() if handler is not signal.SIG_IGN]
    for number in heard:
        signal.signal(number, _remember)
    timer = hasattr(signal, "setitimer")
    if timer:
        before[signal.SIGALRM] = signal.signal(signal.SIGALRM, _again)
    try:
        yield
    finally:
        _State.listening = False  # from here on nothing is raised
        _State.last, _State.asked = _State.asked, None
        if timer:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            heard.append(signal.SIGALRM)
        for number in heard:
            handler = before[number]
            signal.signal(number, signal.SIG_IGN if to_the_end else signal.SIG_DFL if handler is None else handler)


@contextlib.contextmanager
def solving() -> Iterator[None]:
    """Let a signal stop the solver that is run inside, which reads `asked`, and raise KeyboardInterrupt when it has stopped.

    Outside of `listening` (in a program of the user's) that holds for Ctrl-C, and the user's own handler is called after
    the solver has stopped.
    """
    if _State.listening or threading.current_thread() is not threading.main_thread():
        yield
        check()
        return
    before = signal.getsignal(signal.SIGINT)
    if before in (signal.SIG_IGN, None):
        yield
        return
    _State.asked = None
    signal.signal(signal.SIGINT, _only_remember)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        interrupted, _State.asked = _State.asked, None
    if interrupted is not None:
        if callable(before):
            before(signal.SIGINT, None)
        raise KeyboardInterrupt


def _only_remember(number: int, frame: FrameType | None) -> None:
    del frame
    _State.asked = number


def _remember(number: int, frame: FrameType | None) -> None:
    if _State.asked is None:
        _State.asked = number
    _State.times += 1
    if _State.times >= _AT_ONCE and not _State.shields:
        os._exit(128 + _State.asked)
    _again(number, frame)


def _again(number: int, frame: FrameType | None) -> None:
    del number
    if _State.asked is None or not _State.listening:
        return
    may = not _State.shields and can_raise(frame)
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, _LATER_S if may else _SOON_S)
    if may:
        raise KeyboardInterrupt


def can_raise(frame: FrameType | None) -> bool:
    """Return whether an exception raised in a frame reaches its callers: not through CasADi, nor from a destructor."""
    while frame is not None:
        if frame.f_code.co_name == "__del__" or frame.f_globals.get("__name__", "").partition(".")[0] == "casadi":
            return False
        frame = frame.f_back
    return True
