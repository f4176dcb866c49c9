"""MuJoCo's warnings, kept for each thread: MuJoCo has one handler of warnings for the whole process."""

import contextlib
import threading
import warnings
from collections.abc import Iterator

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
