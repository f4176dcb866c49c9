"""The command line's parser: argparse that refuses in one line, with the nearest word to one that is misspelled."""

import argparse
import itertools
import sys
from collections.abc import Sequence
from typing import NoReturn, TextIO

from linkplan.models.errors import one_line
from linkplan.models.names import nearest
from linkplan.studies.cli.exit_codes import BAD_INPUT, DONE
from linkplan.studies.cli.printing import delivered, put


class Parser(argparse.ArgumentParser):
    """A parser that refuses in one line, and knows the nearest word to one that is misspelled."""

    def __init__(self, *arguments, **settings) -> None:  # argparse's own
        argparse.ArgumentParser.__init__(self, *arguments, **settings)
        self.options: list[str] = ["-h", "--help"]
        self.commands: dict[str, Parser] = {}

    def add_argument(self, *names: str, **settings) -> argparse.Action:  # argparse's own
        """Add an argument, and remember an option's names."""
        if "options" in vars(self):
            self.options += [name for name in names if name.startswith("-")]
        return argparse.ArgumentParser.add_argument(self, *names, **settings)

    def error(self, message: str) -> NoReturn:
        """Print the refusal and leave with exit code 2."""
        put(sys.stderr, f"{self.prog}: {one_line(message)} ({self.prog} --help says more)\n")
        raise SystemExit(BAD_INPUT)

    def print_help(self, file: TextIO | None = None) -> NoReturn:
        """Print the help and leave, with exit code 0 where it could be printed."""
        raise SystemExit(delivered("", put(sys.stdout if file is None else file, self.format_help()), DONE))

    def refuse_misspelled(self, words: Sequence[str]) -> None:
        """Leave with the nearest word where a command or option is none: before argparse, which names them without it."""
        place = next((k for k, word in enumerate(words) if not word.startswith("-")), len(words))
        self._refuse_options(words[:place])
        if place == len(words):
            return
        name = words[place]
        if name not in self.commands:
            self.error(f"unknown command '{name}'{nearest(name, self.commands)}; commands are {', '.join(self.commands)}")
        self.commands[name]._refuse_options(words[place + 1 :])

    def _refuse_options(self, words: Sequence[str]) -> None:
        for word in itertools.takewhile(lambda word: word != "--", words):
            if not word.startswith("-"):
                continue
            name = word.partition("=")[0]
            # argparse takes a beginning for the whole; "-o" may have its folder in the same word
            if name.startswith("--") and not any(option.startswith(name) for option in self.options):
                self.error(f"unknown option '{name}'{nearest(name, self.options)}; options are {', '.join(self.options)}")
            if not name.startswith("--") and f"-{name}" in self.options:
                self.error(f"unknown option '{name}' (did you mean '-{name}'?)")
