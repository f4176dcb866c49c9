"""Checks of paths and times given by callers."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from linkplan.models.errors import ProblemError, refusals, shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from linkplan.studies.output.figure_spec import FigureSpec


def check_flags(**given: object) -> None:
    """Refuse an argument that is neither True nor False; the arguments are those of the caller, by name."""
    import numpy as np

    for key, value in given.items():
        if not isinstance(value, bool | np.bool_):
            raise ProblemError(f"{key} must be True or False, got {shown(repr(value), 60)}")


def path_of(value: object, key: str) -> Path:
    """Return the path given by a caller.

    Raises:
        ProblemError: with the name of the argument, if it is neither text nor a path, or if no file can have this path.
    """
    if not isinstance(value, str | os.PathLike) or not isinstance(os.fspath(value), str):
        raise ProblemError(f"{key} must be a path, as text or pathlib.Path, got {value!r}")
    text = os.fspath(value)
    try:
        parts = [os.fsencode(part) for part in Path(text).parts]
    except UnicodeEncodeError as error:
        raise ProblemError(f"{key} must be a path, got {text!r}") from error
    if not text or "\0" in text or any(len(part) > 255 for part in parts):
        raise ProblemError(f"{key} must be a path whose names have 1 to 255 bytes without null bytes, got {text!r}")
    return Path(text)


def folder_to_write(value: object, record: str) -> Path:
    """Return the folder for a result with a record of this name, after a check that it can be written.

    Raises:
        LinkplanError: if it cannot be written, or holds something else.
    """
    from linkplan.planner.files.folders import check_target

    target = path_of(value, "folder")
    check_target(target, record)
    return target


def file_to_write(value: object) -> Path:
    """Return the path of a new file, after a check that it can be written.

    Raises:
        LinkplanError: if it cannot be written, or there is a file.
    """
    from linkplan.planner.files.single_file import check_new

    target = path_of(value, "path")
    check_new(target)
    return target


def require_parquet(what: str) -> None:
    """Raise an error if the package for Parquet is not installed."""
    from linkplan.models.extras import load_extra

    load_extra("pyarrow.parquet", what)


def plain_json(record: object) -> str:
    """Return a record as one line of JSON."""
    from linkplan.planner.files.folders import to_json_types

    return json.dumps(to_json_types(record), allow_nan=False)


def result_identity(folder: Path) -> str | None:
    """Return the identity of the result in a folder; None if there is none."""
    from linkplan.planner.files.manifest import identity_at

    return identity_at(folder)


def drawn(path: object, make: "Callable[[], FigureSpec]") -> "Figure":
    """Check the path, make the figure, save it at the path if one is given, and return it.

    Raises:
        LinkplanError: if the path is invalid, the file cannot be written, or its suffix is not that of a picture.
    """
    from linkplan.studies.output.figure import figure_of

    if path is None:
        return figure_of(make())
    place, spec = path_of(path, "path"), make()
    with refusals(f"'{place}' cannot be written", ValueError):
        return figure_of(spec, place)
