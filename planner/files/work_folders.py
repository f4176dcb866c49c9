"""Work folders: where a result is written before it takes its place, and what is left of one when its process is killed.

A work folder stands beside the result that it is for, named `.linkplan-work-HOST-PID-IDENTITY`. Its owner holds a lock in it
for as long as it lives, so that the next run tells a work folder that is in use from one that was left behind. In it are

    new    a result that is being written;
    swap   the new result, complete, until it has changed places with the earlier one, which then stands here;
    old    where folders cannot change places in one step: the earlier result, until the new one stands in its place.

`settle` ends a work folder at whatever point its owner stopped: a new result that has not taken its place is thrown away, an
earlier result whose place is empty goes back to it, the user's files in an earlier result go over to the newer one, and of
the earlier one the files are deleted that its manifest lists. Nothing else is ever deleted.
"""

import contextlib
import ctypes
import errno
import json
import os
import re
import shutil
import socket
import stat
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from linkplan.models.errors import PlanFileError
from linkplan.models.interrupts import shielded
from linkplan.planner.files.manifest import MANIFEST, RECORDS, earlier_files, files_in, read_manifest, with_inner

try:
    import fcntl
except ImportError:  # not POSIX: locks are done without, and age decides
    fcntl = None

_PREFIX = ".linkplan-work-"
_OWNER, _LOCK = "owner.json", "lock"
# A work folder without a lock in it is being made, which takes no time, or was left at that.
_UNLOCKED_S = 60.0
# Where there are no locks: longer than any command takes.
_NO_LOCKS_S = 7 * 24 * 3600.0
# renameat2's flag, and "relative to the working folder".
_EXCHANGE, _HERE = 2, -100
_CANNOT_EXCHANGE = {errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EPERM}


@dataclass(frozen=True, slots=True)
class WorkFolder:
    """A work folder of this process, its lock held: the identity is in its name and in its result's manifest."""

    path: Path
    identity: str


@contextlib.contextmanager
def work_folder(place: Path) -> Iterator[WorkFolder]:
    """Give a work folder beside a result's place, settled at the end whatever happens."""
    host = re.sub(r"[^A-Za-z0-9.]", "_", socket.gethostname())[:32] or "host"
    lock = None
    identity, path = _named(place, host)
    try:
        path.mkdir(mode=0o700)
        while (lock := _locked(path / _LOCK, make=True)) is None and not path.exists():
            identity, path = _named(place, host)  # the last was empty yet, and another run has swept it
            path.mkdir(mode=0o700)
        (path / _OWNER).write_text(json.dumps({"identity": identity, "place": place.name}) + "\n", encoding="utf-8")
        yield WorkFolder(path, identity)
    finally:
        with shielded():
            try:
                settle(path)
            finally:
                if lock is not None:
                    os.close(lock)


def _named(place: Path, host: str) -> tuple[str, Path]:
    identity = os.urandom(8).hex()
    return identity, place.parent / f"{_PREFIX}{host}-{os.getpid()}-{identity}"


def sweep(parent: Path) -> None:
    """Settle the work folders in a folder whose owners are gone; those that cannot be settled are left as they are."""
    try:
        left = [Path(entry.path) for entry in os.scandir(parent) if entry.name.startswith(_PREFIX)]
    except OSError:
        return
    for path in left:
        with contextlib.suppress(OSError, PlanFileError):
            found = path.lstat()
            if not stat.S_ISDIR(found.st_mode) or (hasattr(os, "geteuid") and found.st_uid != os.geteuid()):
                continue
            lock = _locked(path / _LOCK, make=False) if fcntl is not None else None
            unlocked_s = _NO_LOCKS_S if fcntl is None else _UNLOCKED_S
            in_use = fcntl is not None and (path / _LOCK).exists()
            if lock is None and not in_use:
                with contextlib.suppress(OSError):  # empty: its owner ended, or makes another when it finds it gone
                    path.rmdir()
                    continue
            if lock is None and (in_use or time.time() - found.st_mtime < unlocked_s):
                continue
            try:
                with shielded():
                    settle(path)
            finally:
                if lock is not None:
                    os.close(lock)


def _locked(path: Path, *, make: bool) -> int | None:
    """Return an open, locked file; None where it is not there or somebody else's. It is unlocked when it is closed."""
    try:
        descriptor = os.open(path, os.O_RDWR | (os.O_CREAT if make else 0), 0o600)
    except FileNotFoundError:
        return None
    try:
        if fcntl is not None:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.stat(path)  # gone when its owner settled it in between
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


def take_place(work: WorkFolder, place: Path) -> None:
    """Put a work folder's complete new result into its place, at once; `settle` then does away with the earlier one.

    Raises:
        OSError: when the disk refuses; the earlier result then stands where it stood.
    """
    swap, old = work.path / "swap", work.path / "old"
    (work.path / "new").rename(swap)
    sync(work.path)
    if not place.exists():
        swap.rename(place)
    elif not _exchanged(swap, place):
        place.rename(old)
        swap.rename(place)
    sync_folder(place.parent)


def _exchanged(first: Path, second: Path) -> bool:
    """Let two folders change places in one step; False where the system or the file system has no such step."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return False
    if rename(_HERE, os.fsencode(first), _HERE, os.fsencode(second), _EXCHANGE) == 0:
        return True
    number = ctypes.get_errno()
    if number in _CANNOT_EXCHANGE:
        return False
    raise OSError(number, os.strerror(number))


def sync(folder: Path) -> None:
    """Wait until a folder and everything in it is on the disk."""
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
    """Wait until a folder's names are on the disk, where the system can tell."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # file systems on which folders cannot be waited for
            raise
    finally:
        os.close(descriptor)


def settle(work: Path) -> None:
    """End a work folder: see this file's beginning.

    Raises:
        OSError: when the disk refuses, or somebody put things into the folder that are not linkplan's.
    """
    try:
        said = json.loads((work / _OWNER).read_text(encoding="utf-8"))
        identity, place = str(said["identity"]), work.parent / PurePosixPath(said["place"]).name
    except (OSError, ValueError, KeyError, TypeError):
        identity, place = "", None
    swap = work / "swap"
    if swap.is_dir() and _is_new(swap, identity):
        shutil.rmtree(swap)
    if place is not None:
        for earlier in (work / "old", swap):
            if earlier.is_dir():
                if os.path.lexists(place):
                    hand_over(earlier, place)
                else:
                    earlier.rename(place)
    if (work / "new").is_dir():
        shutil.rmtree(work / "new")
    for name in (_OWNER, _LOCK):
        (work / name).unlink(missing_ok=True)
    with contextlib.suppress(FileNotFoundError):
        work.rmdir()


def stands(work: WorkFolder, place: Path) -> bool:
    """Return whether a work folder's new result has taken its place."""
    return _is_new(place, work.identity)


def _is_new(folder: Path, identity: str) -> bool:
    try:
        manifest = read_manifest(folder)
    except PlanFileError:
        return False
    return manifest is not None and manifest.identity == identity


def link_over(place: Path, fresh: Path, ours: frozenset[str]) -> None:
    """Give the user's files in an earlier result a second name in the new one, so that they are never without a place.

    Folders that hold nothing of ours have one name only, and go over afterwards: as does what cannot have two.
    """
    for name in _theirs(place, ours):
        if (place / name).is_symlink() or (place / name).is_file():
            with contextlib.suppress(OSError):
                (fresh / name).parent.mkdir(parents=True, exist_ok=True)
                os.link(place / name, fresh / name, follow_symlinks=False)


def hand_over(earlier: Path, place: Path) -> None:
    """Move the user's files from an earlier result to the one in its place, and delete the earlier one's own files."""
    try:
        manifest = read_manifest(earlier)
        ours = frozenset() if manifest is None else with_inner(earlier, manifest.files)
    except PlanFileError:
        manifest, ours = None, frozenset()
    if manifest is None:
        found = [files for record in RECORDS if (files := earlier_files(earlier, record)) is not None]
        ours = found[0] if found else frozenset()
    for name in list(_theirs(earlier, ours)):
        source, target = earlier / name, place / name
        if os.path.lexists(target):
            if os.path.samestat(source.lstat(), target.lstat()):
                source.unlink()
                continue
            target = _free(target)
        target.parent.mkdir(parents=True, exist_ok=True)
        source.rename(target)
    for name in sorted(ours, key=lambda name: name.endswith(MANIFEST)):  # manifests last: they say what is ours
        (earlier / name).unlink(missing_ok=True)
    if manifest is not None:
        (earlier / MANIFEST).unlink(missing_ok=True)
    _remove_empty(earlier)


def _theirs(folder: Path, ours: frozenset[str], below: str = "") -> Iterator[str]:
    """Yield the path of what is not ours in a result: files, and whole folders that hold nothing of ours."""
    shared = {str(parent) for name in ours for parent in PurePosixPath(name).parents}
    for entry in sorted((folder / below).iterdir()):
        name = f"{below}/{entry.name}" if below else entry.name
        if name in ours or name == MANIFEST:
            continue
        if entry.is_dir() and not entry.is_symlink() and name in shared:
            yield from _theirs(folder, ours, name)
        else:
            yield name


def _free(path: Path) -> Path:
    """Return a name beside one that is taken."""
    number = 1
    while os.path.lexists(other := path.with_name(f"{path.name}.kept-{number}")):
        number += 1
    return other


def _remove_empty(folder: Path) -> None:
    for entry in folder.iterdir():
        if entry.is_dir() and not entry.is_symlink():
            _remove_empty(entry)
    folder.rmdir()


def unmovable(place: Path, ours: frozenset[str]) -> str | None:
    """Return the name of a folder of the user's in a result that could not go over to a newer one, or None.

    To move a folder, its own entry of the folder above it is written.
    """
    folders = (name for name in _theirs(place, ours) if (place / name).is_dir() and not (place / name).is_symlink())
    return next((name for name in folders if not os.access(place / name, os.W_OK)), None)


def taken(place: Path, ours: frozenset[str], files: frozenset[str]) -> str | None:
    """Return the name of something of the user's that stands where a new result has a file or a folder, or None."""
    if not place.is_dir():
        return None
    folders = {str(parent) for name in files for parent in PurePosixPath(name).parents}
    for name in _theirs(place, ours):
        if name in files or (name in folders and not (place / name).is_dir()):
            return name
        if name in folders and any(f"{name}/{inner}" in files for inner in files_in(place / name)):
            return name
    return None
