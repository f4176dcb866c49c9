"""Checks of paths and times given by callers."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from linkplan.models.errors import PlanFileError, ProblemError

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def path_of(value: object, key: str) -> Path:
    """Return the path given by a caller.

    Raises:
        ProblemError: with the name of the argument, if it is neither text nor a path, or if no file can have this path.
    """
    if not isinstance(value, str | os.PathLike) or not isinstance(os.fspath(value), str):
        raise ProblemError(f"{key} is a path, a text or a pathlib.Path, got {value!r}")
    text = os.fspath(value)
    try:
        parts = [os.fsencode(part) for part in Path(text).parts]
    except UnicodeEncodeError as error:
        raise ProblemError(f"{key} is a path, got what is no text: {text!r}") from error
    if not text or "\0" in text or any(len(part) > 255 for part in parts):
        raise ProblemError(f"{key} is a path whose names have 1 to 255 bytes, none of them zero, got {text!r}")
    return Path(text)


def drawn(path: object, draw: Callable[[Path | None], "Figure"]) -> "Figure":
    """Return a figure, saved at a path if one is given.

    Raises:
        LinkplanError: if the path is invalid, the file cannot be written, or its suffix is not that of a picture.
    """
    if path is None:
        return draw(None)
    place = path_of(path, "path")
    try:
        return draw(place)
    except (OSError, ValueError) as error:
        raise PlanFileError(f"'{place}' cannot be written: {getattr(error, 'strerror', None) or error}") from error
