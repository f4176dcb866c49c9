"""Printing: a result on stdout, messages and progress on stderr. This file has no heavy imports.

A stream may be closed, on a full disk, or in another encoding. A failure to print never ends a command. If the result could
not be printed, `arguments.lost` is the reason. Progress is plain lines, or on a terminal one line that is updated with the
seconds.
"""

import argparse
import errno
import io
import os
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, TextIO

from linkplan.cli.exit_codes import BAD_INPUT, ExitCode
from linkplan.models.deadline import check
from linkplan.models.errors import shown

if TYPE_CHECKING:
    from rich.live import Live
    from rich.text import Text

    from linkplan.studies.output.document import Block


# ECMA-48, "Select graphic rendition". Constants, because a message about lack of memory must not load a library.
_RED, _PLAIN = "\x1b[31m", "\x1b[0m"


def is_terminal(stream: TextIO | None) -> bool:
    """Tell if a stream is a terminal."""
    try:
        return stream is not None and stream.isatty()
    except (OSError, ValueError):  # closed
        return False


def rewrites(stream: TextIO | None) -> bool:
    """Tell if a stream is a terminal on which a line can be overwritten."""
    return is_terminal(stream) and os.environ.get("TERM", "dumb") not in ("", "dumb")


def put(stream: TextIO | None, text: str) -> OSError | None:
    """Write a text and return the error, if any: a closed stream, a broken pipe, a full disk.

    Characters that the stream's encoding lacks are escaped.
    """
    if stream is None or stream.closed:
        return OSError(errno.EBADF, os.strerror(errno.EBADF))
    encoding = getattr(stream, "encoding", None) or "utf-8"
    encoded = text.encode(encoding, "backslashreplace")
    raw = getattr(stream, "buffer", None)
    try:
        if isinstance(
            raw, io.RawIOBase
        ):  # unbuffered (python -u), where the stream loses what the file does not take at once
            while encoded:
                encoded = encoded[raw.write(encoded) or 0 :]
        else:
            stream.write(encoded.decode(encoding))
        stream.flush()
    except OSError as error:
        return error
    return None


def _live(drawn: Callable[[], "Text"]) -> "Live":
    """Return a terminal line that is updated from `drawn`."""
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


def refuse(command: str, text: str) -> None:
    """Print the reason why a command has no result in one line on stderr."""
    who = " ".join(["linkplan", *command.split()])
    if rewrites(sys.stderr) and not os.environ.get("NO_COLOR"):
        who = f"{_RED}{who}{_PLAIN}"
    put(sys.stderr, f"{who}: {text}\n")


def delivered(command: str, lost: OSError | None, code: int) -> int:
    """Return the exit code of a command; `lost` is the error that kept its result from being printed, if any."""
    if lost is None:
        return code
    if isinstance(lost, BrokenPipeError):
        return ExitCode.BROKEN_PIPE
    closed = lost.errno == errno.EBADF
    why = "stdout is closed" if closed else f"the result cannot be written: {lost.strerror or lost}"
    refuse(command, why)
    return BAD_INPUT


def progress(arguments: argparse.Namespace) -> Progress:
    """Return the display of a command's progress on stderr; `show` ends it."""
    arguments.progress = Progress(arguments.command)
    return arguments.progress


def show(
    arguments: argparse.Namespace,
    said: dict | Callable[[], dict],
    result: "str | Sequence[Block] | Callable[[], Sequence[Block]]",
) -> None:
    """Print a result: one JSON object with --json, else its text; on a terminal, a document is drawn in its width."""
    quiet(arguments)
    if arguments.json:
        from linkplan.studies.output.paths import plain_json

        text = plain_json(said() if callable(said) else said) + "\n"
    elif isinstance(result, str):
        text = f"{result}\n"
    else:
        result = result() if callable(result) else result
        document = result
        if not getattr(arguments, "all", True):
            from linkplan.studies.output.document import Text
            from linkplan.studies.output.text import in_brief

            document = in_brief(result)
            if len(document) < len(result) or any(short is not whole for short, whole in zip(document, result, strict=True)):
                document = [*document, Text(text="this is a summary; --all prints every row", tone="note")]
        if is_terminal(sys.stdout):
            from linkplan.studies.output.terminal import drawn

            text = drawn(sys.stdout, document)
        else:
            from linkplan.studies.output.text import text_of

            text = f"{text_of(document)}\n"
    arguments.lost = put(sys.stdout, text)


def quiet(arguments: argparse.Namespace) -> None:
    """End the progress display of a command, if there is one."""
    display = getattr(arguments, "progress", None)
    if display is not None:
        display.close()


def keep_closed_streams_closed() -> None:
    """Open the null device for each of stdin, stdout and stderr that was closed when the process started.

    Otherwise the next opened file would get its number, and the output of libraries would go into that file.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)


def flush_streams() -> None:
    """Flush stdout and stderr for the last time; a stream that fails is redirected to the null device, without an error."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None and put(stream, "") is not None:
            with suppress(OSError, ValueError):
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, stream.fileno())
                os.close(nowhere)
