"""One lock of the process for what the libraries below do not allow two threads to do at once."""

import functools
import threading
from collections.abc import Callable
from typing import ParamSpec, TypeVar

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
