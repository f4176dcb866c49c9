"""The legal names of arguments, from modules that load quickly, and the schema of problem files."""

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
    "TRACKERS",
    "problem_descriptions",
    "problem_keys",
    "schema",
]

DESIGNS = ("latin-hypercube", "grid", "one-at-a-time", "morris", "sobol")
FILE_KINDS = ("problem", "batch", "motors")


def problem_descriptions() -> dict[str, str]:
    """Return the description of each built-in problem."""
    from linkplan.planner.files.tables import read_tables

    return {name: str(read_tables(name)[1].get("description", "")) for name in PROBLEMS}


def problem_keys() -> tuple[str, ...]:
    """Return the keys of problem files, as section.key."""
    from linkplan.planner.problem.keys.reading import KEYS

    return tuple(f"{section}.{key}" for section, keys in KEYS.items() for key in keys)


def schema(file: str = "problem") -> dict:
    """Return the JSON Schema of problem files, of batch files or of lists of motors, for completion in editors.

    Args:
        file: "problem", "batch" or "motors".

    Raises:
        LinkplanError: for another kind of file.

    Example::

        print(linkplan.schema()["title"])
    """
    from linkplan.models.errors import ProblemError, choose
    from linkplan.planner.problem.keys.key_table import FILES, json_schema

    return json_schema(choose("kind of file", file, FILES, ProblemError))
