"""Result folders: written completely or not at all; files of the user are never replaced.

A result is written in a work folder next to its place and synchronised to the disk. Without an earlier result, one rename
puts it in its place. Over an earlier result, one rename puts it into that folder as `.linkplan-new`, and the new result is
valid from then on. Files that only the earlier result had are deleted, the new files are moved one by one, and the manifest
is moved last. If the process is killed in between, the next command that uses the folder completes this (`complete`). The
user's own files in the folder are never changed.
"""

import json
import math
import os
import re
import stat
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path, PurePosixPath

import numpy as np
from msgspec import Struct

from linkplan.models.deadline import check, shielded
from linkplan.models.errors import PlanFileError, refusals
from linkplan.models.work_folders import locked, sweep, sync, sync_folder, work_folder
from linkplan.planner.files.manifest import (
    MANIFEST,
    Manifest,
    files_in,
    is_unchanged,
    read_manifest,
    write_manifest,
)
from linkplan.planner.files.structs import json_values

_NEW_RESULT = ".linkplan-new"


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

    A folder may be written into if it is empty or holds an earlier result of the same kind whose files are unchanged. The
    remains of killed processes are removed first.

    Args:
        target: the result's folder.
        record: the name of the record of that kind of result.

    Raises:
        PlanFileError: if the target is the user's file or folder, if files of the earlier result have changed or must not be
            replaced, or if the folder above cannot be written.
    """
    place = place_of(target)
    with refusals(f"'{target}' cannot be written"):
        sweep(place.parent)
        if place.is_dir():
            sweep(place)
            complete(place)
            _refuse_folder(target, place, record)
        elif os.path.lexists(place):
            raise PlanFileError(f"a result must be a folder; '{target}' is a file")
        parent = place.parent
        while not os.path.lexists(parent):
            parent = parent.parent
        if not parent.is_dir():
            raise PlanFileError(f"'{target}' lies below '{parent}', which is a file")
        if not os.access(parent, os.W_OK | os.X_OK):
            raise PlanFileError(f"'{target}' cannot be written: no permission to write into '{parent}'")


def _refuse_folder(target: Path, place: Path, record: str) -> None:
    """Refuse an existing folder whose content a new result may not replace."""
    if not os.access(place, os.R_OK | os.W_OK | os.X_OK):
        raise PlanFileError(f"'{target}' cannot be replaced: no permission to read and change what is in it")
    mount = _mount_in(place)
    if mount is not None:
        raise PlanFileError(
            f"a file system is mounted at '{mount}', which a result cannot replace; name a folder without mount points"
        )
    manifest = read_manifest(place)
    if manifest is None:
        if any(place.iterdir()):
            held = (
                f"{record} without the {MANIFEST} of a result"
                if (place / record).is_file()
                else "files that are not linkplan's"
            )
            raise PlanFileError(f"'{target}' holds {held}; name a new or an empty folder")
        return
    if manifest.record != record:
        raise PlanFileError(f"'{target}' holds another result ({manifest.record}); name a new or an empty folder")
    for name in manifest.files:
        if os.path.lexists(place / name) and not is_unchanged(place, name, manifest):
            raise PlanFileError(
                f"'{target}' holds '{name}', which has changed since linkplan wrote it; move it or name another folder"
            )
    for name in (*_folders_of(manifest.files), *manifest.files, MANIFEST):
        if os.path.lexists(place / name) and not os.access(place / name, os.W_OK):  # root cannot write immutable files
            raise PlanFileError(f"'{target}' contains '{name}', which cannot be changed; name another folder")


def _mount_in(folder: Path) -> str | None:
    """Return the first mount point at or below a folder, bind mounts included (Linux), or None."""
    if os.path.ismount(folder):
        return str(folder)
    try:
        lines = Path("/proc/self/mountinfo").read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    except OSError:
        return None
    points = (re.sub(r"\\([0-7]{3})", lambda octal: chr(int(octal[1], 8)), line.split()[4]) for line in lines)
    return next((point for point in points if Path(point).is_relative_to(folder)), None)


def _folders_of(names: Iterable[str]) -> set[str]:
    """Return the folders, below a result's own, that contain the named files."""
    return {str(parent) for name in names for parent in PurePosixPath(name).parents} - {"."}


def write_whole(target: Path, write: Callable[[Path], None], record: str = "plan.json") -> None:
    """Write a folder by `write(folder)` next to its place, then move it there; on any failure nothing changes.

    Raises:
        PlanFileError: when the disk refuses, or something in the folder belongs to the user.
    """
    check_target(target, record)
    place = place_of(target)
    made: list[Path] = []
    try:
        with refusals(f"cannot write '{target}'"):
            made = _make_parents(place)
            with work_folder(place.parent) as work:
                write(work)
                check()
                write_manifest(work, record)
                sync(work)
                with shielded():
                    check_target(target, record)  # again: the work may have taken hours
                    _put_in_place(target, work, place)
                    made = []
    finally:
        for parent in made:
            _remove_if_empty(parent)


def _put_in_place(target: Path, work: Path, place: Path) -> None:
    """Move a complete new result to its place."""
    if not place.is_dir() or not any(place.iterdir()):
        if place.is_dir():
            work.chmod(stat.S_IMODE(place.stat().st_mode))
        work.rename(place)
        sync_folder(place.parent)
        return
    with locked(place):
        old = read_manifest(place)
        name = None if old is None else _taken(place, old, set(files_in(work)) - {MANIFEST})
        if name is not None:
            raise PlanFileError(
                f"'{target}' contains '{name}', which linkplan needs to write; move it or name another folder"
            )
        for folder in sorted(_folders_of(files_in(work))):  # a full disk causes an error here, before anything changes
            (place / folder).mkdir(exist_ok=True)
        work.rename(place / _NEW_RESULT)
        sync_folder(place)
        _complete(place)


def _taken(place: Path, old: Manifest, new: set[str]) -> str | None:
    """Return the first entry of the user's in the place of a new result's file or folder, or None."""
    files = (name for name in sorted(new - set(old.files)) if os.path.lexists(place / name))
    folders = (
        name
        for name in sorted(_folders_of(new) - set(old.files))
        if os.path.lexists(place / name) and ((place / name).is_symlink() or not (place / name).is_dir())
    )
    return next(folders, None) or next(files, None)


def complete(folder: Path) -> None:
    """Complete the replacement of a folder's earlier result after a process was killed.

    Raises:
        PlanFileError: when the disk refuses, or a file to be replaced has changed; the rest of the new result stays in
            `.linkplan-new`.
    """
    if (folder / _NEW_RESULT).is_dir():
        with shielded(), locked(folder):
            _complete(folder)


def _complete(folder: Path) -> None:
    source = folder / _NEW_RESULT
    try:
        new, old = read_manifest(source), read_manifest(folder)
        if new is None:  # the manifest is moved last, so only this folder is left
            _remove_if_empty(source)
            return
        listed = {} if old is None else old.files
        coming = [name for name in new.files if (source / name).is_file()]
        obsolete = [name for name in listed if name not in new.files]
        for name in (*coming, *obsolete):
            if os.path.lexists(folder / name) and (old is None or not is_unchanged(folder, name, old)):
                raise PlanFileError(
                    f"'{folder}' holds '{name}', which changed while it was being replaced; the new result is in '{source}'"
                )
        for name in obsolete:
            (folder / name).unlink(missing_ok=True)
        for name in sorted(_folders_of(listed) - _folders_of(new.files), reverse=True):
            _remove_if_empty(folder / name)
        for name in coming:
            os.replace(source / name, folder / name)
        for name in sorted(_folders_of(new.files), reverse=True):
            _remove_if_empty(source / name)
        sync_folder(folder)
        os.replace(source / MANIFEST, folder / MANIFEST)
        _remove_if_empty(source)
    except OSError as error:
        why = error.strerror or error
        raise PlanFileError(
            f"'{folder}' is only partly replaced: {why}; the rest of the new result is in '{source}'; the next command that"
            " uses the folder continues"
        ) from error


def remove_result(folder: Path) -> None:
    """Remove a result's unchanged files, its manifest, and the folders that are then empty."""
    manifest = read_manifest(folder)
    if manifest is None:
        return
    for name in manifest.files:
        if is_unchanged(folder, name, manifest):
            (folder / name).unlink()
    (folder / MANIFEST).unlink()
    for name in sorted(_folders_of(manifest.files), reverse=True):
        _remove_if_empty(folder / name)
    _remove_if_empty(folder)


def _make_parents(place: Path) -> list[Path]:
    """Make the folders above a result's place and return the new ones, the innermost first."""
    missing = []
    parent = place.parent
    while not parent.exists():
        missing.append(parent)
        parent = parent.parent
    place.parent.mkdir(parents=True, exist_ok=True)
    return missing


def _remove_if_empty(folder: Path) -> None:
    try:
        folder.rmdir()
    except OSError:  # the folder is no longer empty
        return


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
