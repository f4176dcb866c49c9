"""A command's progress on stderr: plain lines, or on a terminal one line that is updated with the seconds."""

import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING

from linkplan.models.deadline import check
from linkplan.models.reading import shown
from linkplan.studies.cli.streams import put, rewrites

if TYPE_CHECKING:
    from rich.live import Live
    from rich.text import Text


def _live(drawn: Callable[[], "Text"]) -> "Live":
    """Return the line of a terminal that shows what `drawn` returns."""
    from rich.live import Live

    from linkplan.studies.output.terminal import console_of

    console = console_of(sys.stderr)
    return Live(console=console, get_renderable=drawn, transient=True, redirect_stdout=False, redirect_stderr=False)


class Progress:
    """Displays the progress of a command, one line at a time, with the seconds since its construction.

    Mutable: it keeps the current line of the terminal. After `close`, further text is printed as plain lines.
    """

    def __init__(self, command: str) -> None:
        self._command = command
        self._begin = time.monotonic()
        self._text = ""
        self._live = _live(self._drawn) if rewrites(sys.stderr) else None

    def __call__(self, text: str) -> None:
        """Show the current work; on a terminal it replaces the last text."""
        if self._live is None:
            put(sys.stderr, f"{self._line(text)}\n")
        else:
            self._text = text
            with suppress(OSError):  # the terminal is gone
                self._live.start()
                self._live.refresh()
        check()

    def keep(self, text: str) -> None:
        """Print a line that stays on the terminal."""
        self._erase()
        put(sys.stderr, f"{self._line(text)}\n")
        check()

    def close(self) -> None:
        """Erase the updated line and stop the updates."""
        self._erase()
        self._live = None

    def _erase(self) -> None:
        if self._live is not None:
            with suppress(OSError):
                self._live.stop()

    def _line(self, text: str) -> str:
        return f"  {self._command} {time.monotonic() - self._begin:5.1f} s: {shown(text, 5000)}"

    def _drawn(self) -> "Text":
        from rich.text import Text

        return Text(self._line(self._text), style="dim", no_wrap=True, overflow="ellipsis")
