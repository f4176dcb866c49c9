"""The parser of the command line, made from the public functions that are commands. This file has no heavy imports.

A function's first parameter is the argument of its command, the others are its options. `folder` and `path` are -o.
"""

import argparse
import re
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, NoReturn

from linkplan.cli import signatures
from linkplan.cli.exit_codes import BAD_INPUT
from linkplan.cli.option_kinds import SOURCES, Kind, kind_of
from linkplan.cli.option_values import Tabled
from linkplan.cli.printing import delivered, put
from linkplan.models.errors import closest, nearest, one_line

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

EPILOG = (
    "exit codes: 0 done; 1 the result is negative (no motion, an unstable loop, problems found), and a message says why;"
    " 2 bad input, or a file that cannot be read or written (a full disk), one line on stderr; 130 interrupted, 143 ended"
    " by SIGTERM; 141 stdout was closed before the result was written (use -o)"
)


class Parser(argparse.ArgumentParser):
    """argparse's parser; an error is one line on stderr."""

    def error(self, message: str) -> NoReturn:
        """Print the error, with the legal word nearest to a misspelled one, and end with exit code 2."""
        choice = re.match(r"(.*invalid choice: '(.*?)') \(choose from (.*)\)", message)
        if choice:
            message = choice[1] + nearest(choice[2], choice[3].replace("'", "").split(", ")) + f"; legal: {choice[3]}"
        message = re.sub(r"invalid (?:float|int) value: (.*)", r"takes a number, got \1", message)
        put(sys.stderr, f"{self.prog}: {one_line(message)} ({self.prog} --help says more)\n")
        raise SystemExit(BAD_INPUT)

    def print_help(self, file: "SupportsWrite[str] | None" = None) -> None:
        """Print the help; end with an exit code that is not 0 if it cannot be written."""
        del file
        lost = put(sys.stdout, self.format_help())
        if lost is not None:
            raise SystemExit(delivered(self.prog.partition(" ")[2], lost, BAD_INPUT))

    def commands(self) -> dict[str, "Parser"]:
        """Return the parsers of the commands by name."""
        return next(action.choices for action in self._actions if isinstance(action, argparse._SubParsersAction))

    def refuse_unknown(self, command: str | None, unknown: Sequence[str]) -> NoReturn:
        """Refuse arguments that a command does not take, with the option nearest to the first misspelled one."""
        parser = self if command is None else self.commands()[command]
        options = [name.lstrip("-") for action in parser._actions for name in action.option_strings]
        misspelled = next((word.partition("=")[0].lstrip("-") for word in unknown if word.startswith("--")), None)
        match = None if misspelled is None else closest(misspelled, options)
        hint = "" if match is None else f" (did you mean '--{match}'?)"
        if misspelled is not None and match is None and "set" in options:
            hint = " (keys of the problem are set by --set KEY=VALUE)"
        parser.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")


# What the command line offers for many commands: what is printed, what is written further, and how a file is read.
SHOWING = {
    "all": "print every row and finding, not a summary or the worst of many similar rows",
    "report": "with -o: write report.html, an animated page, too",
    "parquet": "with -o: write the tables as Parquet too",
    "jumps": "with -o: write both sides of each jump in effort into trajectory.csv, at the same time",
}
READING = {
    "anyway": "run a saved plan that does not pass its certificate, with a note and exit code 1",
    "set": (
        "set any key of the problem file, e.g. motion.duration_s=0.2 (a TOML value; a word without quotes is a string);"
        " may be repeated"
    ),
}


def build_parser() -> Parser:
    """Return the command line's parser."""
    parser = Parser(
        prog="linkplan",
        description="Optimal-control motion planning for closed-chain mechanisms.",
        epilog=EPILOG,
    )
    _flag(parser, "version", "print linkplan's version and exit")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=Parser)
    for command in signatures.commands().values():
        text = command.text
        sub = subparsers.add_parser(command.name, help=text, description=f"{text[0].upper()}{text[1:]}.")
        sub.epilog = f"{command.note}; {EPILOG}" if command.note else EPILOG
        _add_command(sub, command)
    return parser


def _add_command(parser: argparse.ArgumentParser, command: signatures.Command) -> None:
    """Add the arguments and options of a command."""
    _flag(parser, "json", "print one JSON object on stdout and nothing else")
    positional = command.positional
    for parameter in command.parameters:
        _add_parameter(parser, parameter, is_positional=parameter is positional)
    if command.saved:
        parser.add_argument(
            "-o", "--output", metavar="DIR", help="write results and figures into this folder, completely or not at all"
        )
    for name in command.showing:
        _flag(parser, name, SHOWING[name])
    own = {parameter.name for parameter in command.parameters}
    reading = SOURCES.get("" if positional is None else positional.annotation, ())
    for name in (name for name in reading if name not in (*command.without, *own)):
        if name == "set":
            parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help=READING["set"])
        elif name == "anyway":
            _flag(parser, "anyway", READING["anyway"])
        else:
            _add_parameter(parser, signatures.selection_parameters()[name], is_positional=False)
    parser.set_defaults(positional="" if positional is None else positional.name)


def _add_parameter(parser: argparse.ArgumentParser, parameter: signatures.Parameter, *, is_positional: bool) -> None:
    """Add a parameter as an argument or option; what is not given is left to the function's default."""
    kind, name = kind_of(parameter.name, parameter.annotation), parameter.name.replace("_", "-")
    text = _help_text(kind if is_positional or parameter.annotation not in SOURCES else Kind(metavar=""), parameter)
    if is_positional:
        nargs = "?" if parameter.is_optional else None
        default = argparse.SUPPRESS if parameter.is_optional else None
        parser.add_argument(parameter.name, metavar=kind.metavar, help=text, type=kind.parse, nargs=nargs, default=default)
    elif parameter.name in ("folder", "path"):
        default = None if parameter.default is signatures.NEEDED else parameter.default
        needed = not parameter.is_optional
        parser.add_argument("-o", "--output", metavar=kind.metavar, help=text, default=default, required=needed)
    elif parameter.default is False:
        _flag(parser, name, text)
    elif parameter.default is True:
        parser.add_argument(f"--no-{name}", action="store_false", dest=parameter.name, help=f"leave this out: {text}")
    else:
        parser.add_argument(
            f"--{name}",
            action=Tabled if kind.is_table else "append" if kind.is_repeated else "store",
            metavar=kind.metavar,
            help=text,
            type=kind.parse,
            default=argparse.SUPPRESS,
            required=not parameter.is_optional,
        )


def _help_text(kind: Kind, parameter: signatures.Parameter) -> str:
    """Return the help of a parameter: its sentence, or that of its kind, and its default."""
    text, default = (kind.text or parameter.text.removeprefix("whether ")).replace("%", "%%"), parameter.default
    text += "; may be repeated" if kind.is_repeated or kind.is_table else ""
    if default in (signatures.NEEDED, None, ()) or isinstance(default, bool) or "default" in text:
        return text
    shown = ", ".join(map(str, default)) if isinstance(default, tuple) else default
    return f"{text} (default: {shown})"


def _flag(parser: argparse.ArgumentParser, name: str, text: str) -> None:
    parser.add_argument(f"--{name}", action="store_true", help=text)
