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
import time
from collections.abc import Callable
from typing import TextIO

from linkplan.models.interrupts import check
from linkplan.studies.cli.exit_codes import BAD_INPUT, NOBODY_READS

Say = Callable[[str], None]


def put(stream: TextIO | None, text: str) -> OSError | None:
    """Write a text and return why it cannot be: the stream is closed, its reader has left, the disk is full.

    What the stream's encoding has no characters for is escaped.
    """
    if stream is None or stream.closed:
        return OSError(errno.EBADF, os.strerror(errno.EBADF))
    encoding = getattr(stream, "encoding", None) or "utf-8"
    try:
        stream.write(text.encode(encoding, "backslashreplace").decode(encoding))
        stream.flush()
    except OSError as error:
        return error
    return None


def refuse(command: str, text: str) -> None:
    """Print why a command has no result, in a line on stderr, where there is one."""
    put(sys.stderr, f"{' '.join(['linkplan', *command.split()])}: {text}\n")


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


def progress(arguments: argparse.Namespace) -> Say:
    """Return the function that prints a command's progress on stderr, with the seconds since it was made."""
    begin = time.monotonic()

    def say(text: str) -> None:
        put(sys.stderr, f"  {arguments.command} {time.monotonic() - begin:5.1f} s: {text}\n")
        check()

    return say


def show(arguments: argparse.Namespace, said: dict | Callable[[], dict], text: str) -> None:
    """Print a result: one JSON object, made where it is wanted, or the text for people."""
    if arguments.json:
        from linkplan.planner.files.folders import plain  # loads numpy, which a list of names does without

        text = json.dumps(plain(said() if callable(said) else said), allow_nan=False)
    arguments.lost = put(sys.stdout, f"{text}\n")


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
