"""The text output of `linkplan decompose`: tables of eighty columns with causes as rows and trackers as columns."""

import math

from linkplan.studies.decompose.decompose import Decomposition
from linkplan.studies.decompose.ladder import RUNGS
from linkplan.studies.output.tables import folded, table

# Significant digits of the rms error. Its parts have the same number of decimals, so that a column adds up.
_TOTAL_DIGITS = 4


def decomposition_text(found: Decomposition) -> str:
    """Return the parts of every tracker's rms error as a table for each unit, and notes."""
    experiment = found.experiment
    n, period = experiment.n, experiment.reference.period_s
    machines = "1 machine" if n == 1 else f"{n} machines, seed {experiment.settings.seed}"
    duration = period * experiment.reference.n
    lines = [f"{found.plan.problem.name}: parts of the rms error over {duration:.4g} s, {machines}, period {period:g} s"]
    for unit in dict.fromkeys(unit for one in found.trackers for unit in one.shares):
        ours = {one.name: one.shares[unit] for one in found.trackers if unit in one.shares}
        columns = [whole_column([*shares.parts, shares.rms]) for shares in ours.values()]
        labels = [*(text.partition(":")[0] for text in RUNGS.values()), "rms error"]
        rows = [[label, *cells] for label, *cells in zip(labels, *columns, strict=True)]
        lines += ["", table([f"switched on [{unit}]", *ours], rows)]
    lines += ["", *(folded(note) for note in notes(found))]
    return "\n".join(lines)


def notes(found: Decomposition) -> list[str]:
    """Return an explanation of the parts, and the reasons for omitted machines."""
    found_notes = ["Each cause stays switched on. The parts add up to the rms error; a negative part reduces it."]
    for one in found.trackers:
        found_notes += [
            f"{one.name}, {n} of {found.experiment.n} machines left out: {why}" for why, n in one.failures.items()
        ]
    return found_notes


def whole_column(values: list[float]) -> list[str]:
    """Return numbers as text with the decimals that the last number, the total, needs; an exact zero is "0"."""
    whole = abs(values[-1])
    decimals = max(0, _TOTAL_DIGITS - 1 - math.floor(math.log10(whole))) if whole > 0 else 0
    form = f".{_TOTAL_DIGITS - 2}e" if decimals > 2 * _TOTAL_DIGITS else f".{decimals}f"
    return ["0" if value == 0 else _unsigned_zero(f"{value:{form}}") for value in values]


def _unsigned_zero(text: str) -> str:
    """Return a number's text without the minus sign of a rounded zero."""
    return text.lstrip("-") if float(text) == 0 else text
