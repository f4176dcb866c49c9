"""Printing: a result on stdout, progress on stderr. Loads nothing heavy.

Neither may cost a result: what cannot be printed is left out, and where that was the result itself, `arguments.lost` is the
reason.
"""

import argparse
import contextlib
import errno
import json
import os
import sys
from collections.abc import Callable

from linkplan.studies.cli.exit_codes import BAD_INPUT, NOBODY_READS
from linkplan.studies.cli.progress import Progress
from linkplan.studies.cli.streams import put
from linkplan.studies.cli.terminal import coloured, has_colours, is_terminal, painted, width_of, wrapped


def refuse(command: str, text: str) -> None:
    """Print why a command has no result, in a line on stderr, where there is one."""
    who = " ".join(["linkplan", *command.split()])
    put(sys.stderr, f"{coloured(who, 'red') if has_colours(sys.stderr) else who}: {text}\n")


def delivered(command: str, lost: OSError | None, code: int) -> int:
    """Return the exit code of a command whose result could be printed, or could not."""
    if lost is None:
        return code
    if isinstance(lost, BrokenPipeError):
        return NOBODY_READS
    closed = lost.errno == errno.EBADF
    why = "stdout is closed" if closed else f"the result cannot be written: {lost.strerror or lost}"
    refuse(command, why)
    return BAD_INPUT


def progress(arguments: argparse.Namespace) -> Progress:
    """Return what a command tells its progress to, on stderr; the result, when it is shown, ends it."""
    arguments.progress = Progress(arguments.command)
    return arguments.progress


def show(arguments: argparse.Namespace, said: dict | Callable[[], dict], text: str) -> None:
    """Print a result: one JSON object, made where it is wanted, or the text for people.

    In a terminal that is wrapped to its width and coloured.
    """
    quiet(arguments)
    if arguments.json:
        from linkplan.planner.files.folders import plain  # loads numpy, which a list of names does without

        text = json.dumps(plain(said() if callable(said) else said), allow_nan=False)
    else:
        text = wrapped(text, width_of(sys.stdout)) if is_terminal(sys.stdout) else text
        text = painted(text) if has_colours(sys.stdout) else text
    arguments.lost = put(sys.stdout, f"{text}\n")


def quiet(arguments: argparse.Namespace) -> None:
    """End the display of a command's progress, where it has one."""
    display = getattr(arguments, "progress", None)
    if display is not None:
        display.close()


def keep_closed_streams_closed() -> None:
    """Give stdin, stdout and stderr that were closed when the process began to nobody else.

    The next file that is opened would have their numbers, and what libraries print would land in it.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)


def let_go() -> None:
    """Flush stdout and stderr for the last time; what cannot be written goes nowhere, and Python says nothing of it."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None and put(stream, "") is not None:
            with contextlib.suppress(OSError, ValueError):
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, stream.fileno())
                os.close(nowhere)
