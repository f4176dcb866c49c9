"""A decomposition as a document: the parts of every tracker's error as a table and as bars, with their explanation."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from linkplan.studies.decompose.decompose import Decomposition, decomposition_record
from linkplan.studies.decompose.ladder import RUNGS
from linkplan.studies.output.document import LOWERING_COLOUR, RAISING_COLOUR, Axis, Bar, Bars, Block, Span, Text, table_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Significant digits of the rms error. Its parts have the same number of decimals, so that a column adds up.
_TOTAL_DIGITS = 4
_WHOLE = "rms error, the sum of all"


def decomposition_blocks(found: Decomposition) -> list[Block]:
    """Return a table for each unit, with causes in rows and trackers in columns, charts, and notes."""
    experiment = found.experiment
    n, period = experiment.n, experiment.reference.period_s
    machines = "1 machine" if n == 1 else f"{n} machines, seed {experiment.settings.seed}"
    over = f"over {period * experiment.reference.n:.4g} s, {machines}, period {period:g} s"
    blocks: list[Block] = [Text(text=f"{found.plan.problem.name}: parts of the rms error {over}")]
    for unit in dict.fromkeys(unit for one in found.trackers for unit in one.shares):
        ours = {one.name: one.shares[unit] for one in found.trackers if unit in one.shares}
        columns = [whole_column([*shares.parts, shares.rms]) for shares in ours.values()]
        rows = list(zip([*RUNGS.values(), _WHOLE], *columns, strict=True))
        blocks.append(table_of("Parts of the rms error", ["switched on", *((name, unit) for name in ours)], rows))
    blocks += decomposition_charts(decomposition_record(found))
    blocks.append(Text(text="Each cause stays switched on. The parts add up to the rms error; a negative part reduces it."))
    left_out = [
        f"{one.name}, {count} of {n} machines left out: {why}"
        for one in found.trackers
        for why, count in one.failures.items()
    ]
    return [*blocks, *(Text(text=text, tone="note") for text in left_out)]


def decomposition_figure(found: Decomposition, path: Path | None = None) -> "Figure":
    """Return the figure of every tracker's parts, saved at `path` if given; each panel has its own scale."""
    from linkplan.studies.output.figure import figure_of, panels_of

    n = found.experiment.n
    title = f"{found.plan.problem.name}: where the error comes from, {n} machine{'s' if n > 1 else ''}"
    return figure_of(panels_of(decomposition_blocks(found)), path, title=title, columns=2, panel_in=(6.5, 3.0))


def decomposition_charts(record: Mapping) -> list[Bars]:
    """Return a chart for each tracker and unit of a decomposition's record; each part starts at the end of the last one.

    The record has "parts" (name to words) and, by tracker and unit, "rms_error" with its "parts" in that unit.
    """
    words, found = record["parts"], []
    for tracker, said in record["trackers"].items():
        for unit, shares in said.items():
            if not isinstance(shares, Mapping) or "rms_error" not in shares:
                continue
            rows, end = [], 0.0
            *notes, whole_note = whole_column([*shares["parts"].values(), shares["rms_error"]])
            for (name, part), note in zip(shares["parts"].items(), notes, strict=True):
                begin, end = end, end + part
                sign, colour = ("adds to it", RAISING_COLOUR) if part >= 0 else ("takes away", LOWERING_COLOUR)
                span = Span(name=sign, start=begin, end=end, colour=colour)
                rows.append(Bar(label=words[name].partition(":")[0], spans=[span], note=note))
            whole = Span(name="rms error", start=0.0, end=shares["rms_error"], colour=None)
            rows.append(Bar(label="rms error", spans=[whole], note=whole_note))
            axis = Axis(label="part of the rms error", unit=unit)
            found.append(Bars(title=f"{tracker}: parts of the rms error", axis=axis, rows=rows, note_name=f"[{unit}]"))
    return found


def whole_column(values: list[float]) -> list[str]:
    """Return numbers as text with the decimals that the last number, the total, needs; an exact zero is "0"."""
    whole = abs(values[-1])
    decimals = max(0, _TOTAL_DIGITS - 1 - math.floor(math.log10(whole))) if whole > 0 else 0
    form = f".{_TOTAL_DIGITS - 2}e" if decimals > 2 * _TOTAL_DIGITS else f".{decimals}f"
    return ["0" if value == 0 else f"{value:z{form}}" for value in values]  # z: no minus sign of a rounded zero
