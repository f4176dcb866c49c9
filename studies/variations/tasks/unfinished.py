"""Unfinished results on disk: every part is complete or absent, even if the process is killed.

The folder DIR.unfinished, next to the result's folder DIR, has the request (asked.json), the common input of all tasks (an
experiment's plan), and parts/part-00000.NAME and so on, one for each finished task. Each is written under another name,
flushed to disk, and renamed. The next run of the same command continues from there; a run of another command is refused.
"""

import contextlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from linkplan.models.deadline import shielded
from linkplan.models.errors import PlanFileError
from linkplan.models.work_folders import replace_file, sweep
from linkplan.planner.files.folders import plain_record, write_json, write_whole
from linkplan.planner.files.manifest import identity_at, read_record

try:
    import fcntl
except ImportError:  # not POSIX: two simultaneous runs are not detected
    fcntl = None

ASKED, PLAN, PARTS, _LOCK = "asked.json", "plan", "parts", "lock"


def unfinished(target: Path) -> Path:
    """Return the folder of an unfinished result's parts."""
    return target.with_name(f"{target.name}.unfinished")


@contextlib.contextmanager
def parts_folder(target: Path | None) -> Iterator[Path]:
    """Open the folder of a result's parts; without a folder for the result it is a temporary one."""
    if target is not None:
        yield unfinished(target)
        return
    with tempfile.TemporaryDirectory(prefix="linkplan-") as place:
        yield Path(place) / "run"


@contextlib.contextmanager
def working(folder: Path, asked: Mapping, what: str) -> Iterator[None]:
    """Lock a folder of parts for this process; the folder is created, or continued if it has the same request.

    Args:
        folder: of parts.
        asked: the request, everything on which the results depend.
        what: the kind of result, with its article.

    Raises:
        PlanFileError: if the folder has the parts of another request, or another process uses it.
    """
    lock, held = None, False
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT, 0o600)
        if fcntl is not None:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise PlanFileError(f"another process is using '{folder}'") from error
        held = True
        if (folder / ASKED).exists():
            refuse_other(folder / ASKED, asked, f"'{folder}' has parts of {what} with other settings")
        else:
            others = (entry.name for entry in folder.iterdir() if entry.name not in (_LOCK, PLAN) and entry.name[0] != ".")
            if (stranger := next(others, None)) is not None:
                raise PlanFileError(f"'{folder}' contains '{stranger}', which is not part of {what}; move it away")
            replace_file(folder / ASKED, lambda place: write_json(place, asked))
        (folder / PARTS).mkdir(exist_ok=True)
        for place in (folder, folder / PARTS):
            sweep(place)
        yield
    except OSError as error:
        raise PlanFileError(f"cannot write '{folder}': {error.strerror or error}; finished parts are kept") from error
    finally:
        if lock is not None:
            if held and not (folder / PLAN).exists() and not any(folder.glob(f"{PARTS}/part-*")):
                remove(folder)  # no task was finished
            os.close(lock)


def refuse_other(path: Path, asked: Mapping, what: str) -> None:
    """Refuse a folder with another request, with the first difference.

    Raises:
        PlanFileError: if the requests differ.
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
    """Return the finished tasks, whose parts exist."""
    parts = (folder / PARTS).glob("part-[0-9][0-9][0-9][0-9][0-9].*")
    return {int(path.stem.removeprefix("part-")) for path in parts}


def part(folder: Path, task: int, suffix: str) -> Path:
    """Return the path of a task's part."""
    return folder / PARTS / f"part-{task:05d}.{suffix}"


def finish(folder: Path, target: Path, write: Callable[[Path], None], record: str) -> None:
    """Write a complete result by `write(place)`, and then remove its parts, even if a signal arrives meanwhile.

    Raises:
        PlanFileError: if the result cannot be written, or its folder has files of other programs.
    """
    before = identity_at(target)
    try:
        write_whole(target, write, record)
    finally:
        with shielded():
            if identity_at(target) not in (None, before):
                remove(folder)


def remove(folder: Path) -> None:
    """Remove the parts of a finished result, and their folder if it has no other files."""
    for left in (PLAN, PARTS):
        shutil.rmtree(folder / left, ignore_errors=True)
    # The request is removed last: without it, the remains of a killed process would not be recognised as linkplan's.
    for left in (ASKED, _LOCK):
        (folder / left).unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        folder.rmdir()


def remove_left(folder: Path, asked: Mapping) -> None:
    """Remove the parts of a finished result whose process was killed before it did so; parts of other requests remain."""
    with contextlib.suppress(PlanFileError, OSError):
        if folder.is_dir():
            with working(folder, asked, "a result"):
                remove(folder)
