"""Progress of the public functions: logging under the name "linkplan", and the caller's function."""

import logging
from collections.abc import Callable

from linkplan.models.errors import ProblemError

LOG = logging.getLogger("linkplan")
LOG.addHandler(logging.NullHandler())

Progress = Callable[[str], None]


def listener(progress: Progress | None) -> Progress:
    """Return the function that passes lines of progress to the log at INFO, and to `progress` if it is given.

    Raises:
        ProblemError: if `progress` is not callable.
    """
    if progress is not None and not callable(progress):
        raise ProblemError(f"progress is a function of one line of text, got {progress!r}")

    def say(text: str) -> None:
        LOG.info(text)
        if progress is not None:
            progress(text)

    return say
