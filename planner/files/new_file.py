"""Single files that are written: whole or not at all, and never over what is there and not linkplan's."""

import os
from pathlib import Path

from linkplan.models.errors import PlanFileError
from linkplan.planner.files.work_folders import replace_file, work_folder


def check_new(path: Path) -> None:
    """Refuse a place where no file can be made: before long work begins, not after it.

    Raises:
        PlanFileError: where something is there already, or the folder is not there or cannot be written.
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
    """Write a file that is not there yet: beside its place first, then in one step.

    Raises:
        PlanFileError: where something is there, or the disk refuses.
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
                os.link(part, path)  # refuses where something has come there meanwhile, as renaming does not
            except FileExistsError:
                check_new(path)
                raise
            except OSError:  # a file system without hard links
                with path.open("xb") as file:
                    file.write(content)
    except OSError as error:
        raise PlanFileError(f"cannot write '{path}': {error.strerror or error}") from error


def write_over(path: Path, content: bytes) -> None:
    """Write a file in the place of an earlier one, which stands there until the new one is on the disk.

    Raises:
        PlanFileError: where the disk refuses; the earlier one then stands as it stood.
    """
    try:
        place = path.resolve()  # a link to an earlier one stays one
        replace_file(place, lambda work: work.write_bytes(content))
    except (OSError, RuntimeError) as error:
        raise PlanFileError(f"cannot write '{path}': {getattr(error, 'strerror', None) or error}") from error
