"""Result folders: written completely or not at all; files of the user are never replaced.

A result is written in a work folder next to its place, synchronised to the disk, and renamed. An earlier result is first
renamed to `.linkplan-old-NAME` next to it, and removed at the end. If the process is killed between the two names, the next
command that uses the folder puts the earlier result back (`restore`).
"""

import contextlib
import json
import math
import os
import shutil
import stat
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from msgspec import Struct

from linkplan.models.deadline import check, shielded
from linkplan.models.errors import PlanFileError, refusals
from linkplan.models.work_folders import locked, sweep, sync, sync_folder, work_folder
from linkplan.planner.files.manifest import MANIFEST, foreign_file, read_manifest, write_manifest
from linkplan.planner.files.structs import json_values


def place_of(target: Path) -> Path:
    """Return a target folder as a path with links and ".." resolved.

    Raises:
        PlanFileError: for the working folder, the home folder, folders above them, and impossible paths.
    """
    if Path(target).parts[:1] == ("~",):  # a folder named "~" is dangerous: the user might remove it by "rm -r ~"
        raise PlanFileError(f"'{target}' begins with a ~ that no shell has replaced; write the home folder's path")
    # A missing working folder, circular links, a zero byte.
    with refusals(f"'{target}' cannot be the path of a folder", RuntimeError, ValueError):
        place, here = Path(target).resolve(), Path.cwd().resolve()
        os.path.lexists(place)
    if place == here or place in here.parents:
        raise PlanFileError(f"'{target}' is the working folder or above it; name a separate folder for the result")
    try:
        home = Path.home().resolve()
    except (OSError, RuntimeError):  # neither HOME nor an entry of this user
        return place
    if place == home or place in home.parents:
        raise PlanFileError(f"'{target}' is the home folder or above it; name a separate folder for the result")
    return place


def check_target(target: Path, record: str = "plan.json") -> None:
    """Refuse a target that cannot be written, before long work begins.

    A folder may be written if it is missing or empty, or if all its files are those of an earlier result of the same kind.
    The remains of killed processes are removed first.

    Args:
        target: the result's folder.
        record: the name of the record of that kind of result.

    Raises:
        PlanFileError: if the target is a file or has files of the user, or if the folder above cannot be written.
    """
    place = place_of(target)
    with refusals(f"'{target}' cannot be written"):
        sweep(place.parent)
        restore(place)
        if place.is_dir():
            sweep(place)
            _refuse_folder(target, place, record)
        elif os.path.lexists(place):
            raise PlanFileError(f"a result must be a folder; '{target}' is a file")
        parent = next(folder for folder in place.parents if os.path.lexists(folder))
        if not parent.is_dir():
            raise PlanFileError(f"'{target}' lies below '{parent}', which is a file")
        if not os.access(parent, os.W_OK | os.X_OK):
            raise PlanFileError(f"'{target}' cannot be written: no permission to write into '{parent}'")


def _refuse_folder(target: Path, place: Path, record: str) -> None:
    """Refuse an existing folder that is neither empty nor an earlier result of the same kind."""
    if os.path.ismount(place) or not os.access(place, os.R_OK | os.W_OK | os.X_OK):
        raise PlanFileError(f"'{target}' cannot be replaced: it is a mount point, or there is no permission to change it")
    manifest = read_manifest(place)
    if manifest is None:
        if any(place.iterdir()):
            raise PlanFileError(f"'{target}' has files but no {MANIFEST} of a result; name a new or an empty folder")
        return
    if manifest.record != record:
        raise PlanFileError(f"'{target}' holds another result ({manifest.record}); name a new or an empty folder")
    name = foreign_file(place, manifest)
    if name is not None:
        raise PlanFileError(
            f"'{target}' holds '{name}', which is not as linkplan wrote the result; move it or name another folder"
        )


def write_whole(target: Path, write: Callable[[Path], None], record: str = "plan.json") -> None:
    """Write a folder by `write(folder)` next to its place, then move it there; on any failure nothing changes.

    Raises:
        PlanFileError: when the disk refuses, or something in the folder belongs to the user.
    """
    check_target(target, record)
    place = place_of(target)
    missing = [folder for folder in place.parents if not folder.exists()]
    try:
        with refusals(f"cannot write '{target}'"):
            place.parent.mkdir(parents=True, exist_ok=True)
            with work_folder(place.parent) as work:
                write(work)
                check()
                write_manifest(work, record)
                sync(work)
                with shielded():
                    check_target(target, record)  # again: the work may have taken hours
                    _put_in_place(work, place)
    finally:
        for parent in missing:  # the innermost first
            with contextlib.suppress(OSError):  # it is not empty
                parent.rmdir()


def _earlier(place: Path) -> Path:
    """Return the path of the earlier result while it is replaced."""
    return place.parent / f".linkplan-old-{place.name}"


def _put_in_place(work: Path, place: Path) -> None:
    """Move a complete new result to its place, and remove the earlier one or the empty folder there."""
    earlier = _earlier(place)
    with locked(place.parent):
        if place.is_dir():
            work.chmod(stat.S_IMODE(place.stat().st_mode))
            place.rename(earlier)
        try:
            work.rename(place)
        except OSError:
            if earlier.is_dir():
                earlier.rename(place)
            raise
        sync_folder(place.parent)
        shutil.rmtree(earlier, ignore_errors=True)


def restore(folder: Path) -> None:
    """Put back an earlier result that a killed process had set aside; remove it if the newer result is complete.

    Raises:
        PlanFileError: if it cannot be written, if its place holds files of the user, or if the path is impossible.
    """
    with refusals(f"'{folder}' cannot be read", RuntimeError, ValueError):
        place = folder.resolve()
    earlier = _earlier(place)
    if not os.path.isdir(earlier):
        return
    with refusals(f"the earlier result in '{earlier}' cannot be moved to '{place}'"), shielded(), locked(place.parent):
        if (place / MANIFEST).exists():
            shutil.rmtree(earlier, ignore_errors=True)
        elif earlier.is_dir():  # another process may have put it back meanwhile
            earlier.rename(place)


def to_json_types(value: object) -> object:
    """Return `value` in JSON's types: structs as objects, arrays as lists, numbers that are not finite as null."""
    value = json_values(value) if isinstance(value, Struct) else value
    if isinstance(value, Mapping):
        return {str(key): to_json_types(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        known = value.dtype.kind == "f" and bool(np.isfinite(value).all())
        return value.tolist() if known else to_json_types(value.tolist())
    if isinstance(value, list | tuple):
        return [to_json_types(item) for item in value]
    if isinstance(value, np.bool_ | bool):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def plain_record(record: Mapping | Struct) -> dict:
    """Return a record in JSON's types."""
    values = json_values(record) if isinstance(record, Struct) else record
    return {str(key): to_json_types(item) for key, item in values.items()}


def write_json(path: Path, record: Mapping | Struct) -> None:
    """Write a record as JSON with a line for each key; a list of numbers is on one line."""
    path.write_text(_lines(plain_record(record), "\n") + "\n", encoding="utf-8")


def _lines(value: object, line: str) -> str:
    """Return a plain value as indented JSON; `line` begins a line at its depth."""
    inner = f"{line}  "
    if isinstance(value, dict) and value:
        items = [f"{json.dumps(key)}: {_lines(item, inner)}" for key, item in value.items()]
        return f"{{{inner}{f',{inner}'.join(items)}{line}}}"
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        return f"[{inner}{f',{inner}'.join(_lines(item, inner) for item in value)}{line}]"
    return json.dumps(value, allow_nan=False)  # the encoder in C, twenty times as fast as the indenting one
