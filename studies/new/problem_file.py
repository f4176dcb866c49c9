"""The problem file of a first motion: its text, with the model's path as seen from the file."""

import textwrap
from pathlib import Path

from linkplan.models.catalogue import MODELS
from linkplan.studies.new.first_motion import FirstMotion, model_beside
from linkplan.studies.new.problem_text import problem_text


def file_tables(found: FirstMotion, model: str, target: Path | None) -> dict[str, dict]:
    """Return the tables of a first motion's file at `target`."""
    tables = found.tables
    if model not in MODELS:
        tables = tables | {"mechanism": tables["mechanism"] | {"model": model_beside(model, target)}}
    return tables


def first_text(found: FirstMotion, tables: dict[str, dict], steps: tuple[str, str]) -> str:
    """Return the commented text of a first motion's file; `steps` are how to plan it and how to track the plan."""
    plans, tracks = steps
    begin = [
        plans.ljust(42) + "plans it, certifies it between the nodes and saves it",
        tracks.ljust(42) + "tracks it in MuJoCo by PD, PD + feedforward and LQR",
        "",
        *(line for note in found.changed for line in [*textwrap.wrap(f"CHANGED: {note}", 98), ""]),
    ]
    return problem_text(found.mechanism, tables, found.description, begin)
