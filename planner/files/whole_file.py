"""A single file of linkplan's, written whole or not at all, and never over one that is not linkplan's."""

import os
from collections.abc import Callable
from pathlib import Path

from linkplan.models.errors import PlanFileError
from linkplan.models.interrupts import check, shielded
from linkplan.planner.files.work_folders import sweep, sync, sync_folder, work_folder

# What every such file has in it, as its format allows: in a PNG's text, a GIF's comment, an MP4's metadata.
MADE_BY = "made by linkplan render"
_CHUNK = 1 << 20


def check_file_target(target: Path, suffixes: tuple[str, ...]) -> None:
    """Refuse a file that could not be written later: before long work begins, not after it.

    Raises:
        PlanFileError: for another suffix, a folder, a file that linkplan did not write, or a place that cannot be written.
    """
    suffix = target.suffix.lower()
    if suffix not in suffixes:
        raise PlanFileError(f"'{target}' ends in {', '.join(suffixes[:-1])} or {suffixes[-1]}, got '{target.suffix}'")
    try:
        place = target.resolve()
        sweep(place.parent)
        if place.is_dir():
            raise PlanFileError(f"'{target}' is a folder; the result is a file")
        if not place.parent.is_dir():
            raise PlanFileError(f"'{target}' cannot be written: there is no folder '{target.parent}'")
        if not os.access(place.parent, os.W_OK | os.X_OK):
            raise PlanFileError(f"'{target}' cannot be written: no permission to write into '{target.parent}'")
        if os.path.lexists(place) and not _is_ours(place):
            raise PlanFileError(f"'{target}' is there and not linkplan's; move it or name another file")
    except (OSError, RuntimeError, ValueError) as error:
        raise PlanFileError(f"'{target}' cannot be written: {getattr(error, 'strerror', None) or error}") from error


def write_file_whole(target: Path, suffixes: tuple[str, ...], write: Callable[[Path], None]) -> None:
    """Write a file by `write(path)` beside its place, then let it take its place; on any failure nothing changes.

    Raises:
        PlanFileError: when the disk refuses, or a file stands in the place that is not linkplan's.
    """
    check_file_target(target, suffixes)
    place = target.resolve()
    try:
        with work_folder(place) as work:
            fresh = work.path / "new"
            fresh.mkdir()
            write(fresh / place.name)
            check()
            with shielded():
                check_file_target(target, suffixes)  # again: the work may have taken long
                sync(fresh)
                os.replace(fresh / place.name, place)
                sync_folder(place.parent)
    except OSError as error:
        raise PlanFileError(f"cannot write '{target}': {error.strerror or error}") from error


def _is_ours(path: Path) -> bool:
    """Return whether a file says that linkplan made it; an empty one holds nothing to lose."""
    if not path.is_file():
        return False
    mark, kept = MADE_BY.encode(), b""
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            if mark in kept + chunk:
                return True
            kept = chunk[-len(mark) :]
    return path.stat().st_size == 0
