"""A command's progress on stderr: plain lines, or on a terminal one line that is rewritten, its seconds going on."""

import sys
import threading
import time

from linkplan.models.interrupts import check
from linkplan.models.reading import shown
from linkplan.studies.cli.streams import put
from linkplan.studies.cli.terminal import coloured, has_colours, moves, width_of

# How often the seconds are written again [s].
_TICK_S = 0.2
# ECMA-48: to the line's beginning, and erase it.
_AGAIN = "\r\x1b[2K"
# Lines longer than this name something that is no name.
_LONGEST = 5000


class Progress:
    """Where a command says what it is doing, a line of text at a time, with the seconds since it was made.

    Mutable: it keeps the line that stands on the terminal. `close` ends it; what is said after it are plain lines.
    """

    def __init__(self, command: str) -> None:
        self._command = command
        self._begin = time.monotonic()
        self._moves = moves(sys.stderr)
        self._colours = has_colours(sys.stderr)
        self._text = ""
        self._lock = threading.Lock()
        self._done = threading.Event()
        self._ticker: threading.Thread | None = None

    def __call__(self, text: str) -> None:
        """Say what is being done now; on a terminal it takes the place of what was said before."""
        if self._moves:
            with self._lock:
                self._text = text
                self._draw()
            if self._ticker is None:
                self._ticker = threading.Thread(target=self._tick, daemon=True)
                self._ticker.start()
        else:
            put(sys.stderr, f"{self._line(text)}\n")
        check()

    def keep(self, text: str) -> None:
        """Say what is to stay on the terminal."""
        with self._lock:
            put(sys.stderr, f"{_AGAIN if self._moves else ''}{self._line(text)}\n")
            self._text = ""
        check()

    def close(self) -> None:
        """Erase the line that is rewritten, and write no more."""
        self._done.set()
        if self._ticker is not None:
            self._ticker.join()
            self._ticker = None
        if self._moves and self._text:
            put(sys.stderr, _AGAIN)
        self._text, self._moves = "", False

    def _line(self, text: str) -> str:
        return f"  {self._command} {time.monotonic() - self._begin:5.1f} s: {shown(text, _LONGEST)}"

    def _draw(self) -> None:
        if self._text:
            line = self._line(self._text)
            room = width_of(sys.stderr) - 1
            line = line if len(line) <= room else f"{line[: room - 3]}..."
            put(sys.stderr, _AGAIN + (coloured(line, "dim") if self._colours else line))

    def _tick(self) -> None:
        while not self._done.wait(_TICK_S):
            with self._lock:
                self._draw()
