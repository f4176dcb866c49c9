"""Where a task runs: in the folder and with the versions of the process that asks for it, alone in its own process."""

import contextlib
import os
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from linkplan.models.errors import LinkplanError
from linkplan.planner.files.plan_folder import versions

# A worker of a cluster may run several tasks in threads: CasADi's functions and the working folder are one for a process.
_ALONE = threading.Lock()


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Site:
    """The folder that relative paths are from, and the versions that results depend on."""

    folder: str
    versions: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Refused:
    """What a task was refused with, in words: not every error can be sent from one process to another."""

    text: str


def this_site() -> Site:
    """Return the site of this process."""
    return Site(folder=os.getcwd(), versions=versions())


def at_site(site: Site, work: Callable, *given: object) -> object:
    """Return what `work` returns at a site, or what it was refused with."""
    try:
        with _ALONE, _in_folder(site.folder):
            _refuse_other_versions(site)
            return work(*given)
    except LinkplanError as error:
        return Refused(str(error))


def _refuse_other_versions(site: Site) -> None:
    mine = versions()
    other = [
        f"{name} {mine.get(name)}, here {version}" for name, version in site.versions.items() if mine.get(name) != version
    ]
    if other:
        raise LinkplanError(
            f"a worker on {socket.gethostname()} has {other[0]}; results would differ, install the same there"
        )


@contextlib.contextmanager
def _in_folder(folder: str) -> Iterator[None]:
    """Work in a folder, in which modules are looked for too."""
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
