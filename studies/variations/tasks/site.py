"""The environment of a task: folder and versions of the submitting process, and one task at a time in a process."""

import contextlib
import os
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from linkplan.models.errors import LinkplanError
from linkplan.planner.plan.folder import versions

# A worker of a cluster may run tasks in several threads, which would share CasADi's functions and the working folder.
_ONE_TASK_LOCK = threading.Lock()


@dataclass(frozen=True, slots=True)
class Refused:
    """The text of the error of a task, because not every error can be sent from one process to another."""

    text: str


def at_site(folder: str, expected: Mapping[str, str], work: Callable, *given: object) -> object:
    """Return the result of `work` in a folder, or its error as `Refused`; `expected` are the versions that it needs."""
    try:
        with _ONE_TASK_LOCK, _in_folder(folder):
            _refuse_other_versions(expected)
            return work(*given)
    except LinkplanError as error:
        return Refused(str(error))


def _refuse_other_versions(expected: Mapping[str, str]) -> None:
    mine = versions()
    other = [f"{name} {mine.get(name)}, here {version}" for name, version in expected.items() if mine.get(name) != version]
    if other:
        raise LinkplanError(
            f"a worker on {socket.gethostname()} has {other[0]}; install the same version there, because results could"
            " differ"
        )


@contextlib.contextmanager
def _in_folder(folder: str) -> Iterator[None]:
    """Change to a folder and import modules from it, too."""
    before = os.getcwd()
    if folder == before:
        yield
        return
    try:
        os.chdir(folder)
    except OSError as error:
        raise LinkplanError(
            f"a worker on {socket.gethostname()} does not see '{folder}': all workers share the disk that a command runs on"
        ) from error
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        sys.path.remove(folder)
        os.chdir(before)
