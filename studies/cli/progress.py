"""A command's progress on stderr: plain lines, or on a terminal one line that is updated with the seconds."""

import sys
import threading
import time

from linkplan.models.interrupts import check
from linkplan.models.reading import shown
from linkplan.studies.cli.streams import put
from linkplan.studies.cli.terminal import coloured, has_colours, moves, width_of

# ECMA-48: go to the start of the line, and erase it.
_AGAIN = "\r\x1b[2K"


class Progress:
    """Displays the progress of a command, one line at a time, with the seconds since its construction.

    Mutable: it keeps the current line of the terminal. After `close`, further text is printed as plain lines.
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
        """Show the current work; on a terminal it replaces the last text."""
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
        """Print a line that stays on the terminal."""
        with self._lock:
            put(sys.stderr, f"{_AGAIN if self._moves else ''}{self._line(text)}\n")
            self._text = ""
        check()

    def close(self) -> None:
        """Erase the updated line and stop the updates."""
        self._done.set()
        if self._ticker is not None:
            self._ticker.join()
            self._ticker = None
        if self._moves and self._text:
            put(sys.stderr, _AGAIN)
        self._text, self._moves = "", False

    def _line(self, text: str) -> str:
        return f"  {self._command} {time.monotonic() - self._begin:5.1f} s: {shown(text, 5000)}"

    def _draw(self) -> None:
        if self._text:
            line = self._line(self._text)
            width = width_of(sys.stderr) - 1
            line = line if len(line) <= width else f"{line[: width - 3]}..."
            put(sys.stderr, _AGAIN + (coloured(line, "dim") if self._colours else line))

    def _tick(self) -> None:
        while not self._done.wait(timeout=0.2):
            with self._lock:
                self._draw()
