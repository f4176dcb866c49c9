"""Progress of the public functions: logging under the name "linkplan", and the caller's function."""

import logging
from collections.abc import Callable

from linkplan.models.errors import ProblemError

LOG = logging.getLogger("linkplan")
LOG.addHandler(logging.NullHandler())

Progress = Callable[[str], None]


class Listener:
    """Passes lines of progress to the log at INFO and notes at WARNING, and both to the caller's function."""

    __slots__ = ("_progress",)

    def __init__(self, progress: Progress | None) -> None:
        self._progress = progress

    def __call__(self, text: str) -> None:
        """Pass a line on the current work."""
        LOG.info(text)
        if self._progress is not None:
            self._progress(text)

    def keep(self, text: str) -> None:
        """Pass a note that stays on a terminal, by the caller's `keep` if it has this method."""
        LOG.warning(text)
        if self._progress is not None:
            getattr(self._progress, "keep", self._progress)(text)


def listener(progress: Progress | None) -> Listener:
    """Return the function that passes lines of progress to the log, and to `progress` if it is given.

    Raises:
        ProblemError: if `progress` is not callable.
    """
    if progress is not None and not callable(progress):
        raise ProblemError(f"progress must be a function of one line of text, got {progress!r}")
    return progress if isinstance(progress, Listener) else Listener(progress)
