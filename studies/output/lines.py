"""Lines over time or another common axis, one plot for each unit."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypedDict

import numpy as np

from linkplan.controllers.trackers.names import BUILT_IN
from linkplan.studies.output.document import Axis, DrawnLimit, Plot, Series
from linkplan.studies.output.numbers import drawn_rows, rounded, rounded_times

# More lines with the same unit are divided among several plots.
_MAX_LINES_PER_PLOT = 9
# The usual width of a line [px], and the share of a plot's height within which two lines are drawn as one.
_USUAL_WIDTH, _HIDING_SHARE = 1.6, 0.005


class LineStyle(TypedDict):
    """The look of a line and the index of its colour."""

    look: str
    colour: int


def line_style(index: int) -> LineStyle:
    """Return the look and colour of line `index` of a plot: six colours, first with solid lines, then with dashed lines."""
    looks, n_colours = ("line", "dash", "dashdot"), 6
    return {"look": looks[index // n_colours % len(looks)], "colour": index % n_colours}


def tracker_colour(tracker: str, other: int) -> int:
    """Return the index of a tracker's colour, the same in all figures; `other` for a tracker that is not built in."""
    return BUILT_IN[tracker].colour if tracker in BUILT_IN else other % 7


def overlaid_width(index: int, n_lines: int) -> float:
    """Return the width [px] of line `index` of `n_lines`. Of several, later lines are thinner, and all remain visible."""
    widest, thinnest = 3.4, 1.2
    return _USUAL_WIDTH if n_lines == 1 else round(widest - (widest - thinnest) * index / (n_lines - 1), 2)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Line:
    """A quantity over the common axis: name, values (n,), unit, and its limits [low, high], if it has any."""

    name: str
    values: np.ndarray
    unit: str
    limits: tuple[float, float] = (-np.inf, np.inf)
    look: str = ""  # "": that of `line_style`
    colour: int | None = -1  # -1: that of `line_style`
    width: float = 0.0  # 0: the usual one, or that of `overlaid_width` if lines coincide


def plots(
    title: str,
    what: str,
    x_axis: Axis,
    x: np.ndarray,
    lines: Sequence[Line],
    *,
    group: str = "",
    log: bool = False,
    period: float | None = None,
    ends: tuple[float, float] | None = None,
) -> list[Plot]:
    """Return the plots of lines over x (n,), thinned and rounded: one or more for each unit."""
    found, units = [], list(dict.fromkeys(line.unit for line in lines))
    for unit, of_it in _readable(units, lines):
        columns = np.column_stack([line.values for line in of_it])
        scaled = np.log10(np.where(columns > 0, columns, np.nan)) if log else columns
        rows = drawn_rows(scaled)
        values, covered = columns[rows], _coincide(scaled[rows])
        shown = [rounded(row, log=log) for row in values.T]
        series = []
        for k, (line, y) in enumerate(zip(of_it, shown, strict=True)):
            style = line_style(k)
            look, colour = line.look or style["look"], style["colour"] if line.colour == -1 else line.colour
            known = np.isfinite(values[:, k])
            name = line.name if known.any() else ""  # without a value it has no entry in the legend
            look = "points" if known.any() and not np.any(known[1:] & known[:-1]) else look  # values without neighbours
            width = line.width or (overlaid_width(k, len(of_it)) if covered else _USUAL_WIDTH)
            series.append(Series(name=name, y=y, look=look, colour=colour, width=width))
        whole = len(of_it) == sum(line.unit == unit for line in lines)
        part = "" if whole else f": {of_it[0].name} to {of_it[-1].name}"
        found.append(
            Plot(
                title=f"{title} [{unit}]{part}" if len(units) > 1 else f"{title}{part}",
                group=group,
                x_axis=x_axis,
                y_axis=Axis(label=what, unit=unit, log=log, ends=ends),
                x=rounded_times(x[rows]),
                series=series,
                limits=() if log else _limits(of_it, values),
                period=period,
            )
        )
    return found


@np.errstate(over="ignore", invalid="ignore")  # a diverged run
def _coincide(columns: np.ndarray) -> bool:
    """Tell if two columns of values (n, n_lines) hide each other wherever both have values."""
    span = np.ptp(columns[np.isfinite(columns)]) if np.isfinite(columns).any() else 0.0
    apart = (np.abs(one - other) for one, other in itertools.combinations(columns.T, 2))
    return any(np.isfinite(off).any() and np.nanmax(off) <= _HIDING_SHARE * span for off in apart)


def _readable(units: Sequence[str], lines: Sequence[Line]) -> Iterator[tuple[str, list[Line]]]:
    """Yield the lines of each unit in groups of at most `_MAX_LINES_PER_PLOT`."""
    for unit in units:
        of_it = [line for line in lines if line.unit == unit]
        parts = -(-len(of_it) // _MAX_LINES_PER_PLOT)
        for k in range(parts):
            yield unit, of_it[k * len(of_it) // parts : (k + 1) * len(of_it) // parts]


def _limits(lines: Sequence[Line], values: np.ndarray) -> list[DrawnLimit]:
    """Return the limits of lines; limits that several lines share appear once.

    A limit of more than twice the largest value of each of its lines is omitted, because it would make the lines look flat.
    """
    named: dict[float, list[str]] = {}
    near: set[float] = set()
    for line, row in zip(lines, values.T, strict=True):
        known = np.abs(row[np.isfinite(row)])
        for bound in (float(f"{bound:.6g}") for bound in line.limits if np.isfinite(bound)):
            named.setdefault(bound, []).append(line.name)
            near |= {bound} if abs(bound) <= 2 * known.max(initial=0.0) else set()
    return [DrawnLimit(name=_of(names, len(lines)), value=value) for value, names in named.items() if value in near]


def _of(names: Sequence[str], n_lines: int) -> str:
    if n_lines == 1 or len(names) == n_lines:
        return "limit"
    return f"limit of {', '.join(names[:3])}{' and others' if len(names) > 3 else ''}"


TIME = Axis(label="time", unit="s")
