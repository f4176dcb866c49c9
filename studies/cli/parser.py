"""The command line's parser: argparse, with errors in one line."""

import argparse
import sys
from typing import NoReturn

from linkplan.models.errors import one_line
from linkplan.studies.cli.exit_codes import BAD_INPUT
from linkplan.studies.cli.streams import put


class Parser(argparse.ArgumentParser):
    """argparse's parser; an error is one line on stderr."""

    def error(self, message: str) -> NoReturn:
        """Print the error and end with exit code 2."""
        put(sys.stderr, f"{self.prog}: {one_line(message)} ({self.prog} --help says more)\n")
        raise SystemExit(BAD_INPUT)
