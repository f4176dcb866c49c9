"""A decomposition as a document: the parts of every tracker's error as a table and as bars, with their explanation."""

import math
from collections.abc import Mapping

from linkplan.models.errors import counted
from linkplan.planner.plan.plan import Plan
from linkplan.studies.output.document import (
    LOWERING_COLOUR,
    RAISING_COLOUR,
    Axis,
    Bar,
    Bars,
    Block,
    Report,
    Section,
    Span,
    Text,
    table_of,
)
from linkplan.studies.output.figure_spec import FigureSpec
from linkplan.studies.output.plan_sections import plan_sections
from linkplan.studies.output.report_file import report_of
from linkplan.studies.variations.decompose.decomposition import Decomposition, Shares

# Significant digits of the rms error. Its parts have the same number of decimals, so that a column adds up.
_TOTAL_DIGITS = 4
_WHOLE = "rms error, the sum of all"


def decomposition_blocks(found: Decomposition) -> list[Block]:
    """Return a table for each unit, with causes in rows and trackers in columns, charts, and notes."""
    n = found.machines
    machines = "1 machine" if n == 1 else f"{n} machines, seed {found.seed}"
    over = f"over {found.duration_s:.4g} s, {machines}, period {found.control_period_s:g} s"
    blocks: list[Block] = [Text(text=f"{found.decomposition}: parts of the rms error {over}")]
    for unit in dict.fromkeys(unit for one in found.trackers.values() for unit in one.by_unit):
        ours = {name: one.by_unit[unit] for name, one in found.trackers.items() if unit in one.by_unit}
        columns = [whole_column([*shares.parts.values(), shares.rms_error]) for shares in ours.values()]
        rows = list(zip([*found.parts.values(), _WHOLE], *columns, strict=True))
        blocks.append(table_of("Parts of the rms error", ["switched on", *((name, unit) for name in ours)], rows))
    blocks += decomposition_charts(found)
    blocks.append(Text(text="Each cause stays switched on. The parts add up to the rms error; a negative part reduces it."))
    left_out = [
        f"{name}, {count} of {n} machines omitted: {why}"
        for name, one in found.trackers.items()
        for why, count in one.failures.items()
    ]
    return [*blocks, *(Text(text=text, tone="note") for text in left_out)]


def decomposition_figure(found: Decomposition) -> FigureSpec:
    """Return the figure of every tracker's parts; each panel has its own scale."""
    title = f"{found.decomposition}: where the error comes from, {counted(found.machines, 'machine')}"
    return FigureSpec(panels=decomposition_charts(found), title=title, columns=2, panel_in=(6.5, 3.0))


def decomposition_charts(found: Decomposition) -> list[Bars]:
    """Return a chart for each tracker and unit; each part starts at the end of the last one."""
    return [
        _chart(name, unit, shares, found.parts)
        for name, one in found.trackers.items()
        for unit, shares in one.by_unit.items()
    ]


def _chart(tracker: str, unit: str, shares: Shares, words: Mapping[str, str]) -> Bars:
    rows, end = [], 0.0
    *notes, whole_note = whole_column([*shares.parts.values(), shares.rms_error])
    for (name, part), note in zip(shares.parts.items(), notes, strict=True):
        begin, end = end, end + part
        sign, colour = ("adds to it", RAISING_COLOUR) if part >= 0 else ("takes away", LOWERING_COLOUR)
        span = Span(name=sign, start=begin, end=end, colour=colour)
        rows.append(Bar(label=words[name].partition(":")[0], spans=[span], note=note))
    whole = Span(name="rms error", start=0.0, end=shares.rms_error, colour=None)
    rows.append(Bar(label="rms error", spans=[whole], note=whole_note))
    axis = Axis(label="part of the rms error", unit=unit)
    return Bars(title=f"{tracker}: parts of the rms error", axis=axis, rows=rows, note_name=f"[{unit}]")


def whole_column(values: list[float]) -> list[str]:
    """Return numbers as text with the decimals that the last number, the total, needs; an exact zero is "0"."""
    whole = abs(values[-1])
    decimals = max(0, _TOTAL_DIGITS - 1 - math.floor(math.log10(whole))) if whole > 0 else 0
    form = f".{_TOTAL_DIGITS - 2}e" if decimals > 2 * _TOTAL_DIGITS else f".{decimals}f"
    return ["0" if value == 0 else f"{value:z{form}}" for value in values]  # z: no minus sign of a rounded zero


def decomposition_report(found: Decomposition, plan: Plan) -> Report:
    """Return the report of the causes of trackers' errors on a plan."""
    split = [name for name, one in found.trackers.items() if one.machines]
    lost = [name for name, one in found.trackers.items() if not one.machines]
    verdict = f"split: {', '.join(split) or 'no tracker'}" + (f"; lost: {', '.join(lost)}" if lost else "")
    first = Section(title=f"Where the error comes from: {found.decomposition}", blocks=decomposition_blocks(found))
    return report_of(first.title, verdict, found.found, [first, *plan_sections(plan)])
