"""The solves that led to a saved plan, from its record."""

import math
from dataclasses import fields

from linkplan.planner.refinement.history import Step


def history_of(rows: object) -> tuple[Step, ...]:
    """Return the steps that a record lists under "history", none where it is not a list of such."""
    names = {field.name for field in fields(Step)}
    if not isinstance(rows, list) or not all(isinstance(row, dict) and set(row) <= names for row in rows):
        return ()
    try:
        return tuple(Step(**{**row, "objective": _float(row["objective"])}) for row in rows)
    except (TypeError, KeyError, ValueError):
        return ()


def _float(value: object) -> float:
    return math.nan if value is None else float(value)
