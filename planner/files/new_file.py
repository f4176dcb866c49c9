"""Single new files: written whole or not at all; existing files are never replaced, except linkplan's own."""

import os
from pathlib import Path

from linkplan.models.errors import PlanFileError
from linkplan.planner.files.work_folders import replace_file, work_folder


def check_new(path: Path) -> None:
    """Refuse a path where no file can be made, before long work begins.

    Raises:
        PlanFileError: if the path exists, or its folder is missing or cannot be written.
    """
    try:
        there, folder = os.path.lexists(path), path.parent.is_dir()
    except (OSError, ValueError) as error:
        raise PlanFileError(f"'{path}' is no path for a file: {error}") from error
    if there:
        raise PlanFileError(f"'{path}' is there already, and no file is overwritten; name another, or remove it")
    if not path.name:
        raise PlanFileError(f"'{path}' is no path for a file")
    if not folder:
        raise PlanFileError(f"'{path}' cannot be written: there is no folder '{path.parent}'")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise PlanFileError(f"'{path}' cannot be written: no permission to write into '{path.parent}'")


def write_new(path: Path, content: bytes) -> None:
    """Write a new file: first next to its place, then moved in one step.

    Raises:
        PlanFileError: if the path exists, or the disk refuses.
    """
    check_new(path)
    try:
        with work_folder(path.parent) as work:
            part = work / path.name
            with part.open("xb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            try:
                os.link(part, path)  # unlike renaming, this fails if the path exists by now
            except FileExistsError:
                check_new(path)
                raise
            except OSError:  # a file system without hard links
                with path.open("xb") as file:
                    file.write(content)
    except OSError as error:
        raise PlanFileError(f"cannot write '{path}': {error.strerror or error}") from error


def write_over(path: Path, content: bytes) -> None:
    """Replace an earlier file by a new one in one step, once the new one is on the disk.

    Raises:
        PlanFileError: when the disk refuses; the earlier file is then unchanged.
    """
    try:
        place = path.resolve()  # a link stays a link
        replace_file(place, lambda work: work.write_bytes(content))
    except (OSError, RuntimeError) as error:
        raise PlanFileError(f"cannot write '{path}': {getattr(error, 'strerror', None) or error}") from error
