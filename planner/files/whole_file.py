"""Single result files, written whole or not at all; files of the user are never replaced."""

import os
from collections.abc import Callable
from pathlib import Path

from linkplan.models.errors import PlanFileError
from linkplan.planner.files.work_folders import replace_file, sweep

# The mark of these files, where each format allows it: a PNG's text, a GIF's comment, an MP4's metadata.
MADE_BY = "made by linkplan render"


def check_file_target(target: Path, suffixes: tuple[str, ...]) -> None:
    """Refuse a file that could not be written later, before long work begins.

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
    """Write a file by `write(path)` next to its place, then move it there; on any failure nothing changes.

    Raises:
        PlanFileError: when the disk refuses, or the place holds a file that is not linkplan's.
    """
    check_file_target(target, suffixes)
    place = target.resolve()

    def write_and_check(path: Path) -> None:
        write(path)
        check_file_target(target, suffixes)  # again: the work may have taken long

    try:
        replace_file(place, write_and_check)
    except OSError as error:
        raise PlanFileError(f"cannot write '{target}': {error.strerror or error}") from error


def _is_ours(path: Path) -> bool:
    """Check that a file carries linkplan's mark, or is empty, so that nothing is lost."""
    if not path.is_file():
        return False
    mark, kept = MADE_BY.encode(), b""
    with path.open("rb") as file:
        while chunk := file.read(1 << 20):
            if mark in kept + chunk:
                return True
            kept = chunk[-len(mark) :]
    return path.stat().st_size == 0
