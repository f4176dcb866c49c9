"""A problem file as text: the keys that are set, each with its meaning."""

import os
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

from linkplan.models.catalogue import MODELS
from linkplan.models.errors import ModelError
from linkplan.models.reading import key_text
from linkplan.planner.files.tables import inline
from linkplan.planner.problem.keys.key_table import key_table
from linkplan.studies.check.new.first_motion import FirstMotion

# The largest width of lines, and the column in which comments after values begin.
_LINE_WIDTH, _COMMENT_COLUMN = 100, 44
_HEAD = """\
# Keys that end in _deg are in degrees, those of slides (_m) in metres, all else is SI. Keys that
# are not here keep their defaults. docs/problem-files.md describes every key. An editor that reads
# the JSON schema of problem files offers them.
"""


def problem_text(tables: Mapping[str, Mapping], description: str, begin: Sequence[str] = ()) -> str:
    """Return the text of a problem file: every key that is set, with its meaning.

    Args:
        tables: the keys that are set.
        description: of the problem, in a sentence.
        begin: lines of comment at the top.
    """
    lines = [*(f"# {line}" for line in begin), _HEAD, f"description = {inline(description)}"]
    meanings = {(row.section, row.name): row.doc for row in key_table()}
    for section, keys in tables.items():
        lines += ["", f"[{section}]"]
        for name, value in keys.items():
            lines += _laid_out(f"{key_text(name)} = {inline(value)}", meanings.get((section, name), ""))
    return "\n".join(line.rstrip() for line in lines) + "\n"


def _laid_out(code: str, doc: str) -> list[str]:
    """Return a line of TOML with its comment behind it or, if the line is long, above it."""
    if len(code) + 2 > _COMMENT_COLUMN:
        return [*textwrap.wrap(doc, _LINE_WIDTH, break_on_hyphens=False, initial_indent="# ", subsequent_indent="# "), code]
    first, *rest = textwrap.wrap(doc, _LINE_WIDTH - _COMMENT_COLUMN - 2, break_on_hyphens=False) or [""]
    return [f"{code.ljust(_COMMENT_COLUMN)}# {first}", *(f"{'':{_COMMENT_COLUMN}}# {more}" for more in rest)]


def file_tables(found: FirstMotion, model: str, target: Path | None) -> dict[str, dict]:
    """Return the tables of a first motion's file at `target`."""
    if model in MODELS:
        return found.tables
    if target is not None:  # relative to the folder of the file
        try:
            model = Path(os.path.relpath(Path(model).resolve(), target.resolve().parent)).as_posix()
        except ValueError as error:  # another drive
            raise ModelError(f"'{model}' and '{target}' are on different drives: {error}") from error
    return found.tables | {"mechanism": found.tables["mechanism"] | {"model": model}}


def first_text(found: FirstMotion, tables: dict[str, dict], steps: tuple[str, str]) -> str:
    """Return the commented text of a first motion's file; `steps` are the commands that plan it and track the plan."""
    plans, tracks = steps
    begin = [
        plans.ljust(42) + "plans the motion, certifies it between the nodes and saves it",
        tracks.ljust(42) + "tracks it in MuJoCo by PD, PD + feedforward and LQR",
        "",
        *(line for note in found.changed for line in [*textwrap.wrap(f"CHANGED: {note}", 98), ""]),
    ]
    return problem_text(tables, found.description, begin)
