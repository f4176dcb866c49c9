"""The cache of compiled functions: a folder of libraries that are loaded as code, and so is nobody's but this user's.

An entry is a library and a record: one line with the hash of the rest, which is JSON and has the library's own hash and
size. Both are checked before the library is loaded: what was cut short, altered or put there by somebody else counts as not
there, and is compiled again. Files are moved into place whole, so that processes in parallel at worst compile the same thing
twice; work folders are locked while they are used, and those that a kill left behind are removed by the next run.

The folder holds $LINKPLAN_CACHE_MB megabytes at the most, 2048 by default: beyond them the entries go that were not used for
the longest time. A library that another process has loaded stays with it, whatever becomes of its name; one that goes
between being found and being loaded is compiled again.
"""

import contextlib
import hashlib
import json
import math
import os
import re
import shutil
import stat
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

try:
    import fcntl
except ImportError:  # not POSIX
    fcntl = None

_WORK = ".work-"
# A compilation that was begun so long ago [s] and is not there has failed.
_BEGUN_S = 600.0
# The largest libraries, of legs with thirteen joints, have ten megabytes and a megabyte of record. More is none of ours.
_LARGEST_LIBRARY, _LARGEST_RECORD = 256 << 20, 32 << 20
# The name of one of an entry's two files: nothing else in the folder is ever removed.
_ENTRY = re.compile(r"(k[0-9a-f]{32})\.(so|json)")
# Some hundred of the largest libraries, or ten thousand of a knee's.
MOST_MB = 2048
_OTHERS = stat.S_IWGRP | stat.S_IWOTH
_POSIX = hasattr(os, "geteuid")


def cache_folder() -> Path:
    """Return the folder of compiled functions: $LINKPLAN_CACHE, linkplan in the user's cache folder, or a temporary one's.

    The last is for users without a home, as in containers: `linkplan-` and the user's number, in $TMPDIR or /tmp.

    Raises:
        OSError: when there is no folder for temporary files either.
    """
    own, caches = os.environ.get("LINKPLAN_CACHE"), os.environ.get("XDG_CACHE_HOME")
    if own:
        return Path(own)
    if caches and Path(caches).is_absolute():
        return Path(caches) / "linkplan"
    try:
        home = Path.home()
    except RuntimeError:  # no $HOME, and the user has no entry
        home = None
    if home is not None and home.is_absolute() and os.access(home, os.W_OK | os.X_OK):
        return home / ".cache" / "linkplan"
    return Path(tempfile.gettempdir()) / f"linkplan-{os.geteuid() if _POSIX else 'cache'}"


def trusted_folder(*, make: bool) -> Path:
    """Return the cache's folder, in which nobody else can write, nor where it lies; made where that is wanted.

    Raises:
        OSError: when it is not there or cannot be made, or somebody else owns it or a folder above it, or may write there.
    """
    given = cache_folder()
    if make:
        given.parent.mkdir(parents=True, exist_ok=True)
        given.mkdir(mode=0o700, exist_ok=True)
    folder = given.resolve()
    if not _POSIX:
        return folder
    found = folder.stat()
    if found.st_uid == os.geteuid() and found.st_mode & _OTHERS and not os.environ.get("LINKPLAN_CACHE"):
        folder.chmod(0o700)  # made by an earlier version under a generous umask
        found = folder.stat()
    above = dict.fromkeys([*Path(os.path.abspath(given)).parents, *folder.parents])  # links on the way lie in folders, too
    why = _whose(found) or next((why for one in above if (why := _replaceable(one))), None)
    if why is not None:
        raise PermissionError(
            f"the cache '{folder}' {why}, and what is in it is run: name one of your own in LINKPLAN_CACHE"
        )
    return folder


def _whose(found: os.stat_result) -> str | None:
    """Return in words who else has to do with a folder or file of the cache; None where nobody has."""
    if _POSIX and found.st_uid != os.geteuid():
        return "belongs to somebody else"
    return "may be written by others" if _POSIX and found.st_mode & _OTHERS else None


def _replaceable(above: Path) -> str | None:
    """Return in words that somebody else may put another folder in the place of one in here; None where not.

    A group counts where the cache is named in LINKPLAN_CACHE: in home folders it is often the user's own.
    """
    found = above.stat()
    if found.st_uid not in (0, os.geteuid()):
        return f"lies in '{above}', which belongs to somebody else"
    others = _OTHERS if os.environ.get("LINKPLAN_CACHE") else stat.S_IWOTH
    kept = not found.st_mode & others or found.st_mode & stat.S_ISVTX
    return None if kept else f"lies in '{above}', which others may write"


def find(folder: Path, key: str) -> tuple[Path, dict] | None:
    """Return the library kept under a key and what was said of it; None where there is none that is whole and ours."""
    library = folder / f"{key}.so"
    try:
        check, _, text = _read(folder / f"{key}.json", _LARGEST_RECORD).partition(b"\n")
        if hashlib.sha256(text).hexdigest().encode() != check:
            return None
        said = json.loads(text)
        return (library, said["functions"]) if hash_of(_read(library, _LARGEST_LIBRARY)) == said["library"] else None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def used(folder: Path, key: str) -> None:
    """Note that an entry was used now: its record's date says so, where the disk lets it."""
    with contextlib.suppress(OSError):
        os.utime(folder / f"{key}.json")


def evict(folder: Path, newest: str) -> None:
    """Remove the entries that were not used for the longest time, as many as are beyond the most that the folder holds.

    Args:
        folder: the cache's.
        newest: the key of the entry that was made now, which stays.
    """
    sizes: dict[str, int] = {}
    dates: dict[str, float] = {}
    for entry in os.scandir(folder):
        name = _ENTRY.fullmatch(entry.name)
        with contextlib.suppress(OSError):  # removed by another process meanwhile
            found = entry.stat(follow_symlinks=False)
            if name and stat.S_ISREG(found.st_mode):
                sizes[name[1]] = sizes.get(name[1], 0) + found.st_size
                dates[name[1]] = max(dates.get(name[1], 0.0), found.st_mtime)
    over = sum(sizes.values()) - most_bytes()
    for key in sorted(sizes, key=dates.__getitem__):
        if over <= 0:
            return
        if key != newest:
            for suffix in ("json", "so"):  # without its record a library is none
                with contextlib.suppress(OSError):
                    (folder / f"{key}.{suffix}").unlink()
            over -= sizes[key]


def most_bytes() -> float:
    """Return how much the cache holds at the most: $LINKPLAN_CACHE_MB megabytes, MOST_MB where that is no such number."""
    given = os.environ.get("LINKPLAN_CACHE_MB", "").strip()
    try:
        most = float(given or MOST_MB)
    except ValueError:
        most = math.nan
    if not most >= 0:
        said = f"LINKPLAN_CACHE_MB is a number of megabytes of at least 0, got '{given}'; {MOST_MB} are kept"
        warnings.warn(said, RuntimeWarning, stacklevel=2)
        most = MOST_MB
    return most * 2**20


def keep(built: Path, said: dict, folder: Path, key: str) -> Path:
    """Move a library that was built into the cache, with what is said of it, and return its place.

    Raises:
        OSError: when the disk refuses.
    """
    text = json.dumps({"library": hash_of(built.read_bytes()), "functions": said}).encode()
    record = built.with_suffix(".json")
    record.write_bytes(hashlib.sha256(text).hexdigest().encode() + b"\n" + text)
    for path in (built, record):
        path.chmod(0o600)
        os.replace(path, folder / path.name)
    for mark in ("wanted", "begun"):
        (folder / f"{key}.{mark}").unlink(missing_ok=True)
    return folder / f"{key}.so"


def hash_of(content: bytes) -> str:
    """Return the hash of a library's bytes."""
    return hashlib.sha256(content).hexdigest()


def _read(path: Path, most: int) -> bytes:
    """Return a file's content.

    Raises:
        OSError: when it is no file, a link, somebody else's, or larger than it can be.
    """
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
    with open(descriptor, "rb") as file:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode) or found.st_size > most or _whose(found) is not None:
            raise PermissionError(f"'{path}' is not of this cache")
        return file.read(found.st_size)  # Python sets aside as much as it is asked for


@contextlib.contextmanager
def work_folder(folder: Path) -> Iterator[Path]:
    """Give a folder to compile in, gone at the end.

    Raises:
        OSError: when it cannot be made.
    """
    work = Path(tempfile.mkdtemp(prefix=_WORK, dir=folder))
    lock = None
    try:
        lock = _locked(work)
        yield work
    finally:
        shutil.rmtree(work, ignore_errors=True)
        if lock is not None:
            os.close(lock)


def handed_over(folder: Path) -> tuple[Path, int | None]:
    """Return a folder to compile in and its lock, for another process to take over and to remove.

    Raises:
        OSError: when it cannot be made.
    """
    work = Path(tempfile.mkdtemp(prefix=_WORK, dir=folder))
    return work, _locked(work)


def wanted_again(folder: Path, key: str) -> bool:
    """Return whether a key was wanted before and nobody has begun to compile it within a few minutes; mark that it is now.

    Raises:
        OSError: when the disk refuses.
    """
    mark, begun = folder / f"{key}.wanted", folder / f"{key}.begun"
    try:
        mark.touch(mode=0o600, exist_ok=False)
    except FileExistsError:
        pass
    else:
        return False
    try:
        begun.touch(mode=0o600, exist_ok=False)
    except FileExistsError:
        if time.time() - begun.stat().st_mtime < _BEGUN_S:
            return False
        begun.touch()
    return True


def sweep(folder: Path) -> None:
    """Remove the work folders whose owners are gone."""
    if fcntl is None:
        return
    for left in [folder / entry.name for entry in os.scandir(folder) if entry.name.startswith(_WORK)]:
        with contextlib.suppress(OSError):
            lock = _locked(left)
            try:
                shutil.rmtree(left, ignore_errors=True)
            finally:
                if lock is not None:
                    os.close(lock)


def _locked(work: Path) -> int | None:
    """Return a folder, open and locked until it is closed; None where there are no locks.

    Raises:
        OSError: when somebody else has it.
    """
    if fcntl is None:
        return None
    descriptor = os.open(work, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor
