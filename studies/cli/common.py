"""Functions shared by the commands: output folders, sources with their options, and the end of a command."""

import argparse
import contextlib
from collections.abc import Container, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from linkplan.models.errors import PlanFileError, ProblemError
from linkplan.studies.cli.exit_codes import DONE, NO, ExitCode
from linkplan.studies.cli.printing import show

if TYPE_CHECKING:
    from linkplan.inputs import Source
    from linkplan.outputs import Exported, Rendered
    from linkplan.plans import Plan
    from linkplan.results import Result

# Options for further files in a result's folder.
_WITH_OUTPUT = {"report": "report.html", "parquet": "tables as Parquet", "jumps": "both sides of jumps"}
# Options that select a part of a model: keys of [mechanism].
SELECTION = ("keep", "fix_base", "lock", "keyframe", "drive")


@contextlib.contextmanager
def naming(option: str) -> Iterator[None]:
    """Put the name of an option before the text of a refusal of its value."""
    try:
        yield
    except (PlanFileError, ProblemError) as error:
        raise type(error)(f"{option}: {error}".replace(f"{option}: {option}", option)) from error


def output_folder(arguments: argparse.Namespace) -> Path | None:
    """Return the output folder; an unusable folder is refused before the work starts."""
    if arguments.output is None:
        for option, what in _WITH_OUTPUT.items():
            if getattr(arguments, option, False):
                raise ProblemError(f"--{option} writes {what} into the folder of -o, which is not given; add -o DIR")
        return None
    return folder_asked(arguments)


def folder_asked(arguments: argparse.Namespace) -> Path:
    """Return the folder of -o, which can be written."""
    if not arguments.output:
        raise ProblemError("-o takes a folder, got an empty name")
    from linkplan.paths import folder_to_write, require_parquet

    if getattr(arguments, "parquet", False):
        require_parquet("--parquet")
    with naming("-o"):
        return folder_to_write(arguments.output, f"{arguments.command}.json")


def file_asked(arguments: argparse.Namespace) -> Path:
    """Return the file of -o."""
    if not arguments.output:
        raise ProblemError("-o takes a file, got an empty name")
    return Path(arguments.output)


def new_file(arguments: argparse.Namespace) -> Path | None:
    """Return the file of -o; an existing or unwritable file is refused before the work starts."""
    if arguments.output is None:
        return None
    from linkplan.paths import file_to_write

    with naming("-o"):
        return file_to_write(file_asked(arguments))


def source_asked(arguments: argparse.Namespace, name: str, parameters: Container[str]) -> "Source":
    """Return a source with the options that say how it is read; a function's own `parameters` are left to it."""
    from linkplan.inputs import Source

    selection = {key: getattr(arguments, key, None) for key in SELECTION if key not in parameters}
    return Source(
        name=name,
        settings=tuple(arguments.set),
        selection={key: list(value) if isinstance(value, tuple) else value for key, value in selection.items() if value},
        anyway=getattr(arguments, "anyway", False),
    )


def answered(arguments: argparse.Namespace, result: "Result | Plan | Rendered | Exported") -> ExitCode:
    """Show a result and return its exit code: 1 if its answer is no."""
    show(arguments, result.to_dict, result.blocks)
    return DONE if result.passed else NO
