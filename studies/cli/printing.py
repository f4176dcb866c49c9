"""Printing: a result on stdout, progress on stderr. Loads nothing heavy."""

import argparse
import json
import sys
import time
from collections.abc import Callable

Say = Callable[[str], None]


def progress(arguments: argparse.Namespace) -> Say:
    """Return the function that prints a command's progress on stderr, with the seconds since it was made."""
    begin = time.monotonic()

    def say(text: str) -> None:
        print(f"  {arguments.command} {time.monotonic() - begin:5.1f} s: {text}", file=sys.stderr, flush=True)

    return say


def show(arguments: argparse.Namespace, said: dict, text: str) -> None:
    """Print a result: one JSON object, or the text for people."""
    if not arguments.json:
        print(text)
        return
    from linkplan.planner.files.folders import plain  # loads numpy, which a list of names does without

    print(json.dumps(plain(said), allow_nan=False))
