"""Printing: a result on stdout, progress on stderr. This file has no heavy imports.

A failure to print never ends a command. If the result itself could not be printed, `arguments.lost` is the reason.
"""

import argparse
import contextlib
import errno
import json
import os
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from linkplan.studies.cli.exit_codes import BAD_INPUT, ExitCode
from linkplan.studies.cli.progress import Progress
from linkplan.studies.cli.streams import is_terminal, put, rewrites

if TYPE_CHECKING:
    from linkplan.studies.output.document import Block

# ECMA-48, "Select graphic rendition": written here, because a refusal may be one for want of memory.
_RED, _PLAIN = "\x1b[31m", "\x1b[0m"


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


def show(arguments: argparse.Namespace, said: dict | Callable[[], dict], result: "str | Sequence[Block]") -> None:
    """Print a result: one JSON object with --json, else its text; on a terminal, a document is drawn in its width."""
    quiet(arguments)
    if arguments.json:
        from linkplan.planner.files.folders import plain  # loads numpy, which the text does not need

        text = json.dumps(plain(said() if callable(said) else said), allow_nan=False) + "\n"
    elif isinstance(result, str):
        text = f"{result}\n"
    elif is_terminal(sys.stdout):
        from linkplan.studies.output.terminal import drawn

        text = drawn(sys.stdout, result)
    else:
        from linkplan.studies.output.text import text_of

        text = f"{text_of(result)}\n"
    arguments.lost = put(sys.stdout, text)


def quiet(arguments: argparse.Namespace) -> None:
    """End the display of a command's progress, if it has one."""
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
            with contextlib.suppress(OSError, ValueError):
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, stream.fileno())
                os.close(nowhere)
