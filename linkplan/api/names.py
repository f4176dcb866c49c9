"""The legal names of arguments, from modules that load quickly, and the schema of problem files."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

from linkplan.api.command import command
from linkplan.controllers.controls import KEYS_TEXT
from linkplan.controllers.trackers.names import LINEAR, TRACKERS
from linkplan.models.catalogue import MODELS, PAYLOADS
from linkplan.planner.files.tables import BUILT_IN as PROBLEMS
from linkplan.planner.transcription.scheme_names import NAMES as SCHEMES
from linkplan.studies.handover.export.formats import C_TRACKERS, FOLDER_FORMATS, FORMATS

__all__ = [
    "C_TRACKERS",
    "DESIGNS",
    "FILE_KINDS",
    "FOLDER_FORMATS",
    "FORMATS",
    "KEYS_TEXT",
    "LINEAR",
    "MODELS",
    "PAYLOADS",
    "PROBLEMS",
    "SCHEMES",
    "SELECTION",
    "SHELLS",
    "TRACKERS",
    "problem_descriptions",
    "problem_keys",
    "schema",
]

DESIGNS = ("latin-hypercube", "grid")
FILE_KINDS = ("problem", "phases", "batch", "motors")
# The shells for which completion scripts exist.
SHELLS = ("bash", "zsh", "fish")
# Keys of [mechanism] that select a part of a model.
SELECTION = ("keep", "fix_base", "lock", "keyframe", "drive")
# Types of parameters. The command line takes the legal words of a parameter from its type (`linkplan/cli/option_kinds.py`).
Law: TypeAlias = str
CLaw: TypeAlias = str
TrackerName: TypeAlias = str
Design: TypeAlias = str
FileKind: TypeAlias = str
ExportFormat: TypeAlias = str
Shell: TypeAlias = str
Frequencies: TypeAlias = Sequence[float]


def problem_descriptions() -> dict[str, str]:
    """Return the description of each built-in problem."""
    from linkplan.planner.files.tables import read_tables

    return {name: str(read_tables(name)[1].get("description", "")) for name in PROBLEMS}


def problem_keys() -> tuple[str, ...]:
    """Return the keys of problem files, as section.key."""
    from linkplan.planner.problem.keys.reading import KEYS

    return tuple(f"{section}.{key}" for section, keys in KEYS.items() for key in keys)


@command("print the JSON Schema of problem files, batch files or lists of motors, for editors")
def schema(file: FileKind = "problem", path: str | Path | None = None) -> dict:
    """Return the JSON Schema of problem files, of batch files or of lists of motors, for completion in editors.

    Args:
        file: "problem", "phases", "batch" or "motors".
        path: the JSON file to write the schema into; an older schema of linkplan's is replaced.

    Raises:
        LinkplanError: for another kind of file, or if another file exists at the path.

    Example::

        print(linkplan.schema()["title"])
    """
    from linkplan.models.errors import ProblemError, choose
    from linkplan.planner.problem.keys.key_table import FILES, json_schema

    found = json_schema(choose("kind of file", file, FILES, ProblemError))
    if path is not None:
        from linkplan.planner.files.single_file import write_file_whole
        from linkplan.studies.output.paths import path_of

        text = f"{json.dumps(found, indent=2)}\n"
        mark = '"title": "linkplan '  # that of the whole schema
        write_file_whole(path_of(path, "path"), lambda place: place.write_text(text, encoding="utf-8"), mark=mark)
    return found
