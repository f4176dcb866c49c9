"""The progress of many tasks, with an estimate of the remaining time."""

import time
from collections.abc import Callable

Say = Callable[[str], None]


class Progress:
    """Counts the finished of `total` things and reports them with the remaining time. Mutable: it counts."""

    def __init__(self, total: int, done: int, things: str, say: Say) -> None:
        self._total, self._done, self._things, self._say = total, done, things, say
        self._begin, self._ran = time.monotonic(), 0
        if 0 < done < total:
            say(f"{done} of {total} {things} are done already")

    def more(self, n: int) -> None:
        """Count n more."""
        self._ran, self._done = self._ran + n, self._done + n
        left = self._total - self._done
        each = (time.monotonic() - self._begin) / self._ran
        self._say(f"{self._done} of {self._total} {self._things}{f', about {_span(each * left)} left' if left else ''}")


def _span(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 90 * 60 else f"{seconds / 3600:.1f} h"
