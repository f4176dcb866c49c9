"""Progress and results of the public functions: logging under the name "linkplan", and what their results share."""

import logging
from collections.abc import Callable

from linkplan.models.errors import ProblemError

LOG = logging.getLogger("linkplan")
LOG.addHandler(logging.NullHandler())

Progress = Callable[[str], None]


def listener(progress: Progress | None) -> Progress:
    """Return the function that takes lines of progress: to the log at INFO, and to `progress` where it is given.

    Raises:
        ProblemError: when `progress` cannot be called.
    """
    if progress is not None and not callable(progress):
        raise ProblemError(f"progress is a function of one line of text, got {progress!r}")

    def say(text: str) -> None:
        LOG.info(text)
        if progress is not None:
            progress(text)

    return say
