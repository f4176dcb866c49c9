"""Single files, written completely or not at all; files of the user are never replaced.

`write_new` writes a new file, `write_again` replaces a file that is unchanged since it was written, and `write_file_whole`
replaces only files with linkplan's mark.
"""

import os
from collections.abc import Callable
from pathlib import Path

from linkplan.models.errors import PlanFileError, refusals
from linkplan.models.reading import read_head
from linkplan.models.work_folders import replace_file, sweep, work_folder

# The mark of pictures and films, where each format allows it: a PNG's text, a GIF's comment, an MP4's metadata.
MADE_BY = "made by linkplan render"
# A mark is within this many bytes from the beginning of pictures, films, pages and schemas.
_MARKED_BYTES = 16 << 20


def check_new(path: Path) -> None:
    """Refuse a path where no file can be made, before long work begins.

    Raises:
        PlanFileError: if the path exists, or its folder is missing or cannot be written.
    """
    with refusals(f"'{path}' is no path for a file", ValueError):
        if os.path.lexists(path):
            raise PlanFileError(f"'{path}' already exists, and no file is overwritten; name another, or remove it")
        if not path.name:
            raise PlanFileError(f"'{path}' is no path for a file")
        _check_folder(path, path.parent)


def write_new(path: Path, content: bytes) -> None:
    """Write a new file: first next to its place, then moved in one step.

    Raises:
        PlanFileError: if the path exists, or the disk refuses.
    """
    check_new(path)
    with refusals(f"cannot write '{path}'"), work_folder(path.parent) as work:
        part = work / path.name
        with part.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        try:
            os.link(part, path)  # unlike renaming, this fails if the path now exists
        except FileExistsError:
            check_new(path)
            raise
        except OSError:  # a file system without hard links
            with path.open("xb") as file:
                file.write(content)


def write_again(path: Path, content: bytes, earlier: bytes | None) -> None:
    """Replace a file that was written before with the content `earlier`, or write a new one if there is none.

    Raises:
        PlanFileError: if the file no longer has the content `earlier`, if it is a link, or if it cannot be written.
    """
    if earlier is None or not os.path.lexists(path):
        write_new(path, content)
        return
    with refusals(f"cannot write '{path}'"):
        if path.is_symlink() or not path.is_file() or path.read_bytes() != earlier:
            raise PlanFileError(
                f"'{path}' has changed since it was written, and nothing is overwritten; move it or name another"
            )
        replace_file(path, lambda part: part.write_bytes(content))


def check_file_target(target: Path, suffixes: tuple[str, ...] = (), mark: str = MADE_BY) -> None:
    """Refuse a file that cannot be written, before long work begins.

    An existing file may be replaced if it contains `mark`. If `suffixes` is empty, any suffix is legal.

    Raises:
        PlanFileError: for another suffix, a folder, a file that linkplan did not write, or a place that cannot be written.
    """
    suffix = target.suffix.lower()
    if suffixes and suffix not in suffixes:
        raise PlanFileError(f"'{target}' must end in {', '.join(suffixes[:-1])} or {suffixes[-1]}, got '{target.suffix}'")
    with refusals(f"'{target}' cannot be written", RuntimeError, ValueError):
        place = target.resolve()
        sweep(place.parent)
        if place.is_dir():
            raise PlanFileError(f"'{target}' is a folder; the result must be a file")
        _check_folder(target, place.parent)
        if os.path.lexists(place):
            begin = read_head(place, f"'{place}'", _MARKED_BYTES, PlanFileError)
            if begin and mark.encode() not in begin:
                raise PlanFileError(f"'{target}' exists and was not written by linkplan; move it or name another file")


def write_file_whole(
    target: Path, write: Callable[[Path], object], suffixes: tuple[str, ...] = (), mark: str = MADE_BY
) -> None:
    """Write a file by `write(path)` next to its place, then move it there; on any failure nothing changes.

    Raises:
        PlanFileError: when the disk refuses, or the place holds a file that is not linkplan's.
    """
    check_file_target(target, suffixes, mark)

    def write_and_check(path: Path) -> None:
        write(path)
        check_file_target(target, suffixes, mark)  # again: the work may have taken long

    with refusals(f"cannot write '{target}'"):
        replace_file(target.resolve(), write_and_check)


def _check_folder(path: Path, folder: Path) -> None:
    """Refuse a folder that is missing or cannot be written."""
    if not folder.is_dir():
        raise PlanFileError(f"'{path}' cannot be written: there is no folder '{path.parent}'")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PlanFileError(f"'{path}' cannot be written: no permission to write into '{path.parent}'")
