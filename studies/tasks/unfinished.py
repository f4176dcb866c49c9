"""Results on disk while they are made: parts that are complete or not there, whatever kills the process.

Beside the result's folder DIR stands DIR.unfinished with what was asked (asked.json), what all tasks begin from (an
experiment's plan), and parts/part-00000.NAME and so on, one for each task that is done. Each is written under another name,
waited for, and renamed. The next run of the same command goes on from there; a run of another one is refused.
"""

import contextlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from linkplan.models.errors import PlanFileError
from linkplan.models.interrupts import shielded
from linkplan.planner.files.folders import plain_record, remove_result, write_json, write_whole
from linkplan.planner.files.json_record import read_record
from linkplan.planner.files.manifest import identity_at
from linkplan.planner.files.work_folders import replace_file, sweep

try:
    import fcntl
except ImportError:  # not POSIX: two runs at once are not told apart
    fcntl = None

ASKED, PLAN, PARTS, _LOCK = "asked.json", "plan", "parts", "lock"


def unfinished(target: Path) -> Path:
    """Return where the parts of a result stand until it is whole."""
    return target.with_name(f"{target.name}.unfinished")


@contextlib.contextmanager
def working(folder: Path, asked: Mapping, what: str) -> Iterator[None]:
    """Hold a folder of parts for this process: made, or taken up where the same was asked.

    Args:
        folder: of parts.
        asked: all that the results depend on.
        what: is asked, with its article.

    Raises:
        PlanFileError: when it holds the parts of another request, or another process works on it.
    """
    lock, held = None, False
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT, 0o600)
        if fcntl is not None:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise PlanFileError(f"another process is at work on '{folder}'") from error
        held = True
        _compare(folder, asked, what)
        (folder / PARTS).mkdir(exist_ok=True)
        for place in (folder, folder / PARTS):
            sweep(place)
        yield
    except OSError as error:
        raise PlanFileError(f"cannot write '{folder}': {error.strerror or error}; what is done is kept") from error
    finally:
        if lock is not None:
            if held and not (folder / PLAN).exists() and not any(folder.glob(f"{PARTS}/part-*")):
                remove(folder)  # nothing came of it
            os.close(lock)


def _compare(folder: Path, asked: Mapping, what: str) -> None:
    path = folder / ASKED
    if not path.exists():
        strangers = [entry.name for entry in folder.iterdir() if entry.name not in (_LOCK, PLAN) and entry.name[0] != "."]
        if strangers:
            raise PlanFileError(f"'{folder}' holds '{strangers[0]}', which is none of {what}'s; move it away")
        replace_file(path, lambda place: write_json(place, asked))
        return
    refuse_other(path, asked, f"'{folder}' holds the parts of {what} that was asked otherwise")


def refuse_other(path: Path, asked: Mapping, what: str) -> None:
    """Refuse a folder whose record of what was asked is not this one, with the first thing that differs.

    Raises:
        PlanFileError: when something was asked otherwise.
    """
    try:
        held = read_record(path, dict[str, Any])
    except PlanFileError as error:
        raise PlanFileError(f"{error}; name a new folder") from error
    held = held.get("asked", held)
    if held == json.loads(json.dumps(plain_record(asked))):
        return
    differs = next(iter(_differences(held, asked)), "something")
    raise PlanFileError(f"{what} ({differs}); name a new folder, or remove it")


def _differences(held: object, asked: object, name: str = "") -> Iterator[str]:
    if isinstance(held, Mapping) and isinstance(asked, Mapping):
        for key in dict.fromkeys((*held, *asked)):
            yield from _differences(held.get(key), asked.get(key), f"{name}.{key}" if name else key)
    elif held != asked:
        yield f"{name.removeprefix('settings.')} was {held}, now {asked}"


def done(folder: Path) -> set[int]:
    """Return the tasks whose parts are there."""
    parts = (folder / PARTS).glob("part-[0-9][0-9][0-9][0-9][0-9].*")
    return {int(path.stem.removeprefix("part-")) for path in parts}


def part(folder: Path, task: int, suffix: str) -> Path:
    """Return where a task's part stands."""
    return folder / PARTS / f"part-{task:05d}.{suffix}"


def finish(folder: Path, target: Path, write: Callable[[Path], None], record: str) -> None:
    """Write a result whole by `write(place)`, and remove its parts as soon as it stands, though a signal come just then.

    Raises:
        PlanFileError: when the disk refuses, or something in the result's folder is not linkplan's.
    """
    before = identity_at(target)
    try:
        write_whole(target, write, record)
    finally:
        with shielded():
            if identity_at(target) not in (None, before):
                remove(folder)


def remove(folder: Path) -> None:
    """Remove the parts of a result that is whole, and their folder where nothing else is in it."""
    sweep(folder)
    for left in (folder / PARTS).glob("part-[0-9]*.*"):
        left.unlink(missing_ok=True)
    with contextlib.suppress(OSError, PlanFileError):  # somebody put something into it
        remove_result(folder / PLAN)
    _remove_empty(folder / PLAN, folder / PARTS)
    # The record goes last: without it, what a kill leaves is not known for linkplan's.
    for left in (folder / ASKED, folder / _LOCK):
        left.unlink(missing_ok=True)
    _remove_empty(folder)


def _remove_empty(*folders: Path) -> None:
    for folder in folders:
        with contextlib.suppress(OSError):
            folder.rmdir()


def remove_left(folder: Path, asked: Mapping) -> None:
    """Remove the parts of a result that is whole, where its process was killed before it could: none of another request."""
    with contextlib.suppress(PlanFileError, OSError):
        if folder.is_dir():
            with working(folder, asked, "a result"):
                remove(folder)
