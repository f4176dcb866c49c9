"""Threads: one lock for what the libraries below do not allow two threads to do at once, and MuJoCo's warnings.

MuJoCo has one handler of warnings for the whole process; here they are kept for each thread.
"""

import contextlib
import functools
import threading
import warnings
from collections.abc import Callable, Iterator
from typing import ParamSpec, TypeVar

import mujoco


class _Kept(threading.local):
    """The warnings of one thread; None where nobody keeps them."""

    messages: list[str] | None = None


_KEPT = _Kept()
_KEEPERS: list[int] = []  # the threads that keep warnings; a thread of MuJoCo's own belongs to one of them


def _keep(message: str) -> None:
    if _KEPT.messages is not None:
        _KEPT.messages.append(message)
    elif not _KEEPERS:
        warnings.warn(message, RuntimeWarning, stacklevel=2)


@contextlib.contextmanager
def mujoco_warnings() -> Iterator[list[str]]:
    """Keep the warnings that MuJoCo issues in this thread; by default MuJoCo writes a log file to the working folder."""
    outer, _KEPT.messages = _KEPT.messages, []
    _KEEPERS.append(threading.get_ident())
    try:
        yield _KEPT.messages
    finally:
        _KEEPERS.remove(threading.get_ident())
        _KEPT.messages = outer


# Set once for the process: MuJoCo can deadlock when one thread sets the handler while another compiles a model.
mujoco.set_mju_user_warning(_keep)


_LOCK = threading.RLock()
Asked = ParamSpec("Asked")
Answer = TypeVar("Answer")


def one_thread_at_a_time(function: Callable[Asked, Answer]) -> Callable[Asked, Answer]:
    """Return a function that waits until no other thread is in it, or in any other function with this decorator.

    Its calls may be nested. Three libraries need it: CasADi 3.8 gives up Python's own lock in symbolic calls while it enters
    their constants in one table of the process; msgspec 0.22 prepares a type at its first conversion; and MuJoCo's warnings
    become Python warnings, whose filters belong to the process.
    """

    @functools.wraps(function)
    def alone(*args: Asked.args, **kwargs: Asked.kwargs) -> Answer:
        with _LOCK:
            return function(*args, **kwargs)

    return alone
