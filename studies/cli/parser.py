"""The command line's parser: argparse that refuses in one line, with the nearest word to one that is misspelled."""

import argparse
import itertools
import re
import shlex
import sys
from collections.abc import Sequence
from typing import NoReturn, TextIO

from linkplan.models.errors import one_line
from linkplan.models.names import closest
from linkplan.studies.cli.exit_codes import BAD_INPUT, DONE
from linkplan.studies.cli.printing import delivered
from linkplan.studies.cli.streams import put

# Which command takes a file, by the end of its name.
_TAKEN_BY = {".toml": "plan", ".xml": "check", ".mjcf": "check"}
# argparse's words for a value that is none, and plain ones.
_PLAINLY = {
    r"^argument (\S+): invalid float value: (.*)$": r"\1 is a number, got \2",
    r"^argument (\S+): invalid int value: (.*)$": r"\1 is a whole number, got \2",
    r"^argument (\S+?)(/\S+)?: expected one argument$": r"\1 takes a value, and none is given",
}


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
        for words, said in _PLAINLY.items():
            message = re.sub(words, said, message)
        put(sys.stderr, f"{self.prog}: {one_line(message)} ({self.prog} --help says more)\n")
        raise SystemExit(BAD_INPUT)

    def print_help(self, file: TextIO | None = None) -> NoReturn:
        """Print the help and leave, with exit code 0 where it could be printed."""
        raise SystemExit(delivered("", put(sys.stdout if file is None else file, self.format_help()), DONE))

    def refuse_misspelled(self, words: Sequence[str]) -> None:
        """Leave with the nearest word where a command or option is none: before argparse, which names them without it."""
        self._refuse_before_command(words)
        place = next((k for k, word in enumerate(words) if not word.startswith("-")), len(words))
        self._refuse_options(words[:place])
        if place == len(words):
            return
        name = words[place]
        if name not in self.commands:
            meant = _nearest_option(name, [*self.commands, *self.options])
            by_suffix = [command for suffix, command in _TAKEN_BY.items() if name.endswith(suffix)]
            if by_suffix:
                meant = f" (did you mean 'linkplan {by_suffix[0]} {name}'?)"
            self.error(f"unknown command '{name}'{meant}; commands are {', '.join(self.commands)}")
        self.commands[name]._refuse_options(words[place + 1 :])

    def _refuse_before_command(self, words: Sequence[str]) -> None:
        """Leave where a command's own option, or what it is about, stands before it."""
        place = next((k for k, word in enumerate(words) if word in self.commands), 0)
        first = words[0].partition("=")[0] if words else ""
        if first in self.commands or {first, f"--{first}"} & set(self.options):
            return
        if first.startswith("-") and not any(first in command.options for command in self.commands.values()):
            return  # an option of nobody
        if place:
            line = shlex.join(["linkplan", *words[place:], *words[:place]])
            self.error(f"'{first}' comes after the command: {line}")
        if first.startswith("-"):
            self.error(f"'{first}' is an option of a command and comes after it; commands are {', '.join(self.commands)}")

    def refuse_extra(self, command: str, extra: Sequence[str], *, sets: bool) -> NoReturn:
        """Leave where words are left over; `sets` says whether --set was given, whose value may have fallen apart."""
        in_quotes = "a setting with spaces stands in quotes: --set 'motion.goal_deg = { O = 10 }'"
        hint = in_quotes if sets else "a name with spaces stands in quotes"
        plural = "words" if len(extra) > 1 else "word"
        self.commands[command].error(f"{len(extra)} {plural} too many, '{' '.join(extra)}'; {hint}")

    def _refuse_options(self, words: Sequence[str]) -> None:
        for word in itertools.takewhile(lambda word: word != "--", words):
            if not word.startswith("-"):
                continue
            name = word.partition("=")[0]
            # argparse takes a beginning for the whole; "-o" may have its folder in the same word
            if name.startswith("--") and not any(option.startswith(name) for option in self.options):
                self._refuse_option(name)
            if not name.startswith("--") and f"-{name}" in self.options:
                self.error(f"unknown option '{name}' (did you mean '-{name}'?)")
            if word[1:2].isalpha() and not name.startswith("--") and word[:2] not in self.options:
                self._refuse_option(name)

    def _refuse_option(self, name: str) -> NoReturn:
        said = f"unknown option '{name}'{_nearest_option(name, self.options)}"
        self.error(f"{said}; options are {', '.join(self.options)}")


class NoParser(argparse.ArgumentParser):
    """What stands for the parser of a command that was not given: it takes arguments' descriptions and keeps none."""

    def __init__(self) -> None:
        """Make nothing: what argparse makes takes longer than to parse a command."""

    def add_argument(self, *names: str, **settings) -> argparse.Action:  # argparse's own
        """Forget an argument."""
        del names, settings
        return argparse.Action([], "")

    def set_defaults(self, **values) -> None:  # argparse's own
        """Forget defaults."""
        del values


def _nearest_option(name: str, options: Sequence[str]) -> str:
    """Return " (did you mean '--x'?)" for the option, or word, that is closest; dashes make none close."""
    by_letters = {option.lstrip("-"): option for option in options}
    match = closest(name.lstrip("-"), by_letters)
    return "" if match is None else f" (did you mean '{by_letters[match]}'?)"
