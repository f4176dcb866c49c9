"""The cache of compiled functions: a folder of shared libraries that only this user may write, because they are run.

An entry is a library and a record. The record's first line is the hash of the rest, which is JSON with the library's hash.
Both hashes are checked before the library is loaded. A truncated or altered entry is ignored and compiled again. Files are
moved into place whole, so parallel processes at worst compile the same functions twice.

The folder holds at most $LINKPLAN_CACHE_MB megabytes, 2048 by default. The entries that were unused for the longest time are
removed first. A process keeps a library that it has loaded. A library that is removed between lookup and loading is compiled
again.
"""

import contextlib
import hashlib
import json
import math
import os
import re
import stat
import tempfile
import warnings
from pathlib import Path

# Names of an entry's two files. No other file of the folder is removed.
_ENTRY = re.compile(r"(k[0-9a-f]{32})\.(so|json)")
# Space for about a hundred of the largest libraries, or ten thousand of a four-bar's.
DEFAULT_CACHE_MB = 2048
_WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH
_POSIX = hasattr(os, "geteuid")


def cache_folder() -> Path:
    """Return the cache's folder: $LINKPLAN_CACHE, `linkplan` in the user's cache folder, or a temporary folder.

    Users without a home folder, for example in containers, get `linkplan-` and the user's number in $TMPDIR or /tmp.

    Raises:
        OSError: when there is no folder for temporary files.
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
    """Return the cache's folder after checking that nobody else can write in it or replace it; create it if `make`.

    Raises:
        OSError: when the folder is missing or cannot be created, or when others own it or may write in it or above it.
    """
    given = cache_folder()
    if make:
        given.parent.mkdir(parents=True, exist_ok=True)
        given.mkdir(mode=0o700, exist_ok=True)
    folder = given.resolve()
    if not _POSIX:
        return folder
    found = folder.stat()
    if found.st_uid == os.geteuid() and found.st_mode & _WRITABLE_BY_OTHERS and not os.environ.get("LINKPLAN_CACHE"):
        folder.chmod(0o700)  # an earlier version created it under a permissive umask
        for entry in os.scandir(folder):  # others may have put them there
            if _ENTRY.fullmatch(entry.name):
                os.unlink(entry.path)
        found = folder.stat()
    above = dict.fromkeys([*Path(os.path.abspath(given)).parents, *folder.parents])  # parents of symbolic links count too
    whose = "belongs to somebody else" if found.st_uid != os.geteuid() else None
    open_to = "may be written by others" if found.st_mode & _WRITABLE_BY_OTHERS else None
    why = whose or open_to or next((why for one in above if (why := _replaceable(one))), None)
    if why is not None:
        raise PermissionError(
            f"the cache '{folder}' {why}, and its code would be run: set LINKPLAN_CACHE to a folder of your own"
        )
    return folder


def _replaceable(above: Path) -> str | None:
    """Return a phrase if somebody else may replace a folder inside `above`; else None.

    Group permissions count only for a folder named in LINKPLAN_CACHE, because home folders often belong to a private group.
    """
    found = above.stat()
    if found.st_uid not in (0, os.geteuid()):
        return f"lies in '{above}', which belongs to somebody else"
    others = _WRITABLE_BY_OTHERS if os.environ.get("LINKPLAN_CACHE") else stat.S_IWOTH
    kept = not found.st_mode & others or found.st_mode & stat.S_ISVTX
    return None if kept else f"lies in '{above}', which others may write"


def find_entry(folder: Path, key: str) -> tuple[Path, dict] | None:
    """Return the library kept under a key and its record; None if there is no complete entry."""
    library = folder / f"{key}.so"
    try:
        check, _, text = (folder / f"{key}.json").read_bytes().partition(b"\n")
        if hashlib.sha256(text).hexdigest().encode() != check:
            return None
        record = json.loads(text)
        return (library, record["functions"]) if hash_of(library.read_bytes()) == record["library"] else None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def mark_used(folder: Path, key: str) -> None:
    """Set the date of an entry's record to now, if the disk allows it."""
    with contextlib.suppress(OSError):
        os.utime(folder / f"{key}.json")


def evict(folder: Path, newest: str) -> None:
    """Remove the entries that were unused for the longest time, until the folder is within its size limit.

    Args:
        folder: the cache's folder.
        newest: the key of the entry that was just made, which stays.
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
            for suffix in ("json", "so"):  # the record first: a library without a record is ignored
                with contextlib.suppress(OSError):
                    (folder / f"{key}.{suffix}").unlink()
            over -= sizes[key]


def most_bytes() -> float:
    """Return the size limit of the cache [byte]: $LINKPLAN_CACHE_MB megabytes, or the default if that is no valid number."""
    given = os.environ.get("LINKPLAN_CACHE_MB", "").strip()
    try:
        most = float(given or DEFAULT_CACHE_MB)
    except ValueError:
        most = math.nan
    if not most >= 0:
        message = f"LINKPLAN_CACHE_MB must be megabytes, at least 0, got '{given}'; {DEFAULT_CACHE_MB} are kept"
        warnings.warn(message, RuntimeWarning, stacklevel=2)
        most = DEFAULT_CACHE_MB
    return most * 2**20


def keep_entry(built: Path, entry: dict, folder: Path, key: str) -> Path:
    """Move a new library and its record into the cache, and return the library's path.

    Raises:
        OSError: when the disk refuses.
    """
    text = json.dumps({"library": hash_of(built.read_bytes()), "functions": entry}).encode()
    record = built.with_suffix(".json")
    record.write_bytes(hashlib.sha256(text).hexdigest().encode() + b"\n" + text)
    for path in (built, record):
        path.chmod(0o600)
        os.replace(path, folder / path.name)
    (folder / f"{key}.wanted").unlink(missing_ok=True)
    return folder / f"{key}.so"


def hash_of(content: bytes) -> str:
    """Return the hash of a library's bytes."""
    return hashlib.sha256(content).hexdigest()


def wanted_again(folder: Path, key: str) -> bool:
    """Mark a key as wanted; return True if it was wanted before.

    Raises:
        OSError: when the disk refuses.
    """
    try:
        (folder / f"{key}.wanted").touch(mode=0o600, exist_ok=False)
    except FileExistsError:
        return True
    return False
