"""Result folders: written whole or not at all, and never over what is not linkplan's.

A result is written in a work folder beside its place, brought to the disk, and changes places with the earlier result in one
step. Of the earlier one those files are deleted that its manifest lists; whatever else is in the folder stays in it.
"""

import json
import math
import os
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from linkplan.models.errors import PlanFileError
from linkplan.models.interrupts import check, shielded
from linkplan.planner.files.manifest import MANIFEST, RECORDS, replaceable, write_manifest
from linkplan.planner.files.work_folders import (
    link_over,
    settle,
    stands,
    sweep,
    sync,
    take_place,
    taken,
    unmovable,
    work_folder,
)

__all__ = ["MANIFEST", "RECORDS", "check_target", "place_of", "plain", "plain_record", "write_json", "write_whole"]


def place_of(target: Path) -> Path:
    """Return the folder that a target means, links and ".." resolved; refused where no result may ever be put.

    Raises:
        PlanFileError: for the working folder, the home folder, what is above them, and paths that cannot be.
    """
    if Path(target).parts[:1] == ("~",):  # a folder of that name would be asked for its removal once, by "rm -r ~"
        raise PlanFileError(f"'{target}' begins with a ~ that no shell has replaced; write the home folder's path")
    try:
        place, here = Path(target).resolve(), Path.cwd().resolve()
        os.path.lexists(place)
    except (OSError, RuntimeError, ValueError) as error:  # the working folder is gone; links in a circle; a zero byte
        raise PlanFileError(f"'{target}' is no path for a folder: {getattr(error, 'strerror', None) or error}") from error
    if place == here or place in here.parents:
        raise PlanFileError(f"'{target}' is the working folder or above it; name a folder of its own for the result")
    try:
        home = Path.home().resolve()
    except (OSError, RuntimeError):  # no HOME and no entry of this user's
        return place
    if place == home or place in home.parents:
        raise PlanFileError(f"'{target}' is the home folder or above it; name a folder of its own for the result")
    return place


def check_target(target: Path, record: str = "plan.json") -> None:
    """Refuse a target that could not be written later: before long work begins, not after it.

    A folder may be written into that is empty or holds an older result of the same kind, known by its `record`. What a run
    that was killed left beside it is put in order first.

    Raises:
        PlanFileError: when the target is a file, or a folder with things in it that are not ours, or its parent cannot
            be written.
    """
    _judged(target, place_of(target), record)


def _judged(target: Path, place: Path, record: str) -> frozenset[str]:
    """Return the files in a result's place that may be replaced."""
    try:
        sweep(place.parent)
        if os.path.lexists(place) and not place.is_dir():
            raise PlanFileError(f"a result is a folder; '{target}' is a file")
        if place.is_dir() and os.path.ismount(place):
            raise PlanFileError(
                f"'{target}' is where a file system is mounted, which cannot be replaced; name a folder in it"
            )
        if place.is_dir() and not os.access(place, os.R_OK | os.W_OK | os.X_OK):
            raise PlanFileError(f"'{target}' cannot be replaced: no permission to read and change what is in it")
        if place.is_dir():
            sweep(place)
        ours = replaceable(place, record) if place.is_dir() else frozenset()
        held = unmovable(place, ours) if place.is_dir() else None
        if held is not None:
            raise PlanFileError(f"'{target}' holds '{held}', which cannot be moved: no permission to write into that folder")
        parent = place.parent
        while not os.path.lexists(parent):
            parent = parent.parent
        if not parent.is_dir():
            raise PlanFileError(f"'{target}' lies below '{parent}', which is a file")
        if not os.access(parent, os.W_OK | os.X_OK):
            raise PlanFileError(f"'{target}' cannot be written: no permission to write into '{parent}'")
    except OSError as error:
        raise PlanFileError(f"'{target}' cannot be written: {error.strerror or error}") from error
    return ours


def write_whole(target: Path, write: Callable[[Path], None], record: str = "plan.json") -> None:
    """Write a folder by `write(folder)` beside its place, then let it take its place; on any failure nothing changes.

    Raises:
        PlanFileError: when the disk refuses, or something in the folder is not linkplan's.
    """
    place = place_of(target)
    _judged(target, place, record)
    made, work = [], None
    try:
        made = _make_parents(place)
        with work_folder(place) as work:
            fresh = work.path / "new"
            fresh.mkdir()
            write(fresh)
            check()
            files = write_manifest(fresh, record, work.identity)
            with shielded():
                ours = _judged(target, place, record)  # again: the work may have taken hours
                name = taken(place, ours, files)
                if name is not None:
                    raise PlanFileError(
                        f"'{target}' holds '{name}', which linkplan would now write; move it or name another folder"
                    )
                if place.is_dir():
                    fresh.chmod(place.stat().st_mode & 0o7777)
                    link_over(place, fresh, ours)
                sync(fresh)
                take_place(work, place)
                made = []
                settle(work.path)  # in one shield: the user's folders are in their place before an interrupt is heard
    except OSError as error:
        why = error.strerror or error
        if work is not None and stands(work, place):
            raise PlanFileError(
                f"'{target}' stands, new and whole, but the disk refused afterwards: {why}; what stood there before is in"
                f" '{work.path}' as far as it is not cleared away, which the next run tries again"
            ) from error
        raise PlanFileError(f"cannot write '{target}': {why}") from error
    finally:
        for parent in made:
            _remove_if_empty(parent)


def _make_parents(place: Path) -> list[Path]:
    """Make the folders above a result's place and return those that were not there, the innermost first."""
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
    except OSError:  # somebody has put something there since
        return


def plain(value: object) -> object:
    """Return `value` in JSON's own types: arrays as lists, numbers that are not finite as null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.bool_ | bool):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def plain_record(record: Mapping) -> dict:
    """Return a record in JSON's own types."""
    return {str(key): plain(item) for key, item in record.items()}


def write_json(path: Path, record: Mapping) -> None:
    """Write a record as indented JSON."""
    path.write_text(json.dumps(plain_record(record), indent=2, allow_nan=False) + "\n", encoding="utf-8")
