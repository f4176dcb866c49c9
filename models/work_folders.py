"""Work folders: hidden folders next to a result's place, which hold the result until it is complete.

A work folder is locked while its process lives. An unlocked one was left by a killed process, and the next run in the same
folder removes it.
"""

import contextlib
import errno
import os
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

from linkplan.models.deadline import check, shielded

try:
    import fcntl
except ImportError:  # not POSIX: there are no locks, and remains of killed processes stay
    fcntl = None

_NAME = re.compile(r"\.linkplan-work-[0-9a-f]{16}")


@contextlib.contextmanager
def work_folder(parent: Path) -> Iterator[Path]:
    """Yield a locked, empty work folder in `parent`, and remove it at the end."""
    path, lock = _new_folder(parent)
    while lock is None or not path.exists():  # another run removed it before it was locked
        path, lock = _new_folder(parent)
    try:
        yield path
    finally:
        with shielded():
            shutil.rmtree(path, ignore_errors=True)
            os.close(lock)


def _new_folder(parent: Path) -> tuple[Path, int | None]:
    path = parent / f".linkplan-work-{os.urandom(8).hex()}"
    path.mkdir()
    return path, _lock(path, wait=False)


def _lock(folder: Path, *, wait: bool) -> int | None:
    """Return an open descriptor that holds a folder's lock until it is closed; None if another process holds it."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except FileNotFoundError:
        return None
    try:
        if fcntl is not None:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder's lock, after waiting for the process that has it."""
    lock = _lock(folder, wait=True)
    try:
        yield
    finally:
        if lock is not None:
            os.close(lock)


def sweep(parent: Path) -> None:
    """Remove this user's work folders of ended processes in `parent`, as far as the system allows."""
    if fcntl is None:
        return
    with contextlib.suppress(OSError):
        for path in [Path(entry.path) for entry in os.scandir(parent) if _NAME.fullmatch(entry.name)]:
            if path.is_symlink() or not path.is_dir() or path.stat().st_uid != os.geteuid():
                continue
            lock = _lock(path, wait=False)
            if lock is not None:
                with shielded():
                    shutil.rmtree(path, ignore_errors=True)
                    os.close(lock)


def replace_file(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file by `write(work)`, synchronise it to the disk, and move it to its place in one step.

    Raises:
        OSError: when the disk refuses; an earlier file is then unchanged.
    """
    with work_folder(path.parent) as work:
        fresh = work / path.name
        write(fresh)
        check()
        with shielded():
            if path.exists():
                shutil.copymode(path, fresh)
            sync(work)
            os.replace(fresh, path)
            sync_folder(path.parent)


def sync(folder: Path) -> None:
    """Synchronise a folder and every file in it to the disk; links are not followed."""
    for entry in folder.iterdir():
        if entry.is_symlink():
            continue
        if entry.is_dir():
            sync(entry)
        elif entry.is_file():
            descriptor = os.open(entry, os.O_RDONLY if os.name == "posix" else os.O_RDWR)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
    sync_folder(folder)


def sync_folder(folder: Path) -> None:
    """Synchronise a folder's names to the disk, where the system supports it."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # file systems that cannot synchronise folders
            raise
    finally:
        os.close(descriptor)
