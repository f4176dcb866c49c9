"""The result of a decomposition, whose fields are the record `decompose.json`: every tracker's parts, table and bars."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from msgspec import Struct

from linkplan.models.errors import counted
from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.planner.plan.plan import Plan
from linkplan.studies.output.document import (
    LOWERING_COLOUR,
    RAISING_COLOUR,
    Axis,
    Bar,
    Bars,
    Block,
    NumberText,
    Report,
    Section,
    Span,
    Text,
    table_of,
)
from linkplan.studies.output.figure_spec import FigureSpec
from linkplan.studies.output.plan_sections import plan_sections
from linkplan.studies.output.report_file import report_of
from linkplan.studies.output.result import Result

# Significant digits of the rms error. Its parts have the same number of decimals, so that a column adds up.
_TOTAL_DIGITS = 4
_WHOLE = "rms error, the sum of all"


class Shares(Struct, frozen=True, kw_only=True):
    """The parts of one tracker's rms error, in the error's unit, by cause.

    The `parts` add up to `rms_error`, and so do the `parts_of_joints` over joints and causes. `rms_of_increment` are the rms
    values of each cause's increment; `rms_error_on_rung` is the rms error after each cause is switched on.
    """

    rms_error: float
    parts: dict[str, float]
    parts_of_joints: dict[str, dict[str, float]]
    rms_of_increment: dict[str, float]
    rms_error_on_rung: dict[str, float]


class TrackerShares(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The parts of one tracker's error over the `machines` without a failure, in deg and m, and the failures."""

    machines: int
    failures: dict[str, int]
    deg: Shares | None = None
    m: Shares | None = None

    @property
    def by_unit(self) -> dict[str, Shares]:
        """The parts by the unit of the error."""
        return {unit: shares for unit, shares in (("deg", self.deg), ("m", self.m)) if shares is not None}


class Decomposition(Result, Struct, frozen=True, kw_only=True, eq=False):
    """The causes of the errors of trackers on one plan; `parts` are the causes' names and descriptions."""

    record_name = "decompose"

    decomposition: str
    machines: int
    seed: int
    imperfections: dict[str, Any]
    control_period_s: float
    delay_periods: float
    timestep_s: float
    duration_s: float
    parts: dict[str, str]
    trackers: dict[str, TrackerShares]
    plan: Beside[Plan] = NOT_READ

    @property
    def found(self) -> bool:
        """True if every tracker has at least one machine without a failure."""
        return all(one.machines for one in self.trackers.values())

    @property
    def passed(self) -> bool:
        """Whether the plan passes and every tracker's error is split."""
        return self.plan.passed and self.found

    def figure_specs(self) -> Iterator[tuple[str, FigureSpec]]:
        """Yield decompose, every tracker's parts as bars; each panel has its own scale."""
        title = f"{self.decomposition}: where the error comes from, {counted(self.machines, 'machine')}"
        yield "decompose", FigureSpec(panels=decomposition_charts(self), title=title, columns=2, panel_in=(6.5, 3.0))

    def blocks(self) -> list[Block]:
        """Return a table for each unit, with causes in rows and trackers in columns, charts, and notes."""
        n = self.machines
        machines = "1 machine" if n == 1 else f"{n} machines, seed {self.seed}"
        over = f"over {self.duration_s:.4g} s, {machines}, period {self.control_period_s:g} s"
        blocks: list[Block] = [Text(text=f"{self.decomposition}: parts of the rms error {over}")]
        for unit in dict.fromkeys(unit for one in self.trackers.values() for unit in one.by_unit):
            ours = {name: one.by_unit[unit] for name, one in self.trackers.items() if unit in one.by_unit}
            columns = [whole_column([*shares.parts.values(), shares.rms_error]) for shares in ours.values()]
            rows = list(zip([*self.parts.values(), _WHOLE], *columns, strict=True))
            blocks.append(table_of("Parts of the rms error", ["switched on", *((name, unit) for name in ours)], rows))
        blocks += decomposition_charts(self)
        blocks.append(
            Text(text="Each cause stays switched on. The parts add up to the rms error; a negative part reduces it.")
        )
        left_out = [
            f"{name}, {count} of {n} machines omitted: {why}"
            for name, one in self.trackers.items()
            for why, count in one.failures.items()
        ]
        return [*blocks, *(Text(text=text, tone="note") for text in left_out)]

    def document(self) -> Report:
        """Return the report of the causes of trackers' errors on the plan."""
        split = [name for name, one in self.trackers.items() if one.machines]
        lost = [name for name, one in self.trackers.items() if not one.machines]
        verdict = f"split: {', '.join(split) or 'no tracker'}" + (f"; lost: {', '.join(lost)}" if lost else "")
        first = Section(title=f"Where the error comes from: {self.decomposition}", blocks=self.blocks())
        return report_of(first.title, verdict, self.found, [first, *plan_sections(self.plan)])

    def __repr__(self) -> str:
        return f"Decomposition({self.decomposition!r}: {', '.join(self.trackers)})"


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
    # z: no minus sign of a rounded zero
    return [NumberText.of("0" if value == 0 else f"{value:z{form}}", value) for value in values]
