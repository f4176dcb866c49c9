"""One look for every figure: sizes, grid, and colours that colour-blind readers can tell apart (Okabe & Ito, 2008)."""

import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter

BLUE, ORANGE, GREEN, RED = "#0072B2", "#E69F00", "#009E73", "#D55E00"
SKY, PURPLE, GREY, BLACK = "#56B4E9", "#CC79A7", "#7F7F7F", "#000000"
BROWN = "#8C564B"
TRACKER_COLOURS = {"pd": ORANGE, "pd+ff": GREEN, "lqr": BLUE, "lqi": SKY, "gs-pd+ff": PURPLE, "ct": BROWN, "mpc": RED}
SERIES = (BLUE, ORANGE, GREEN, PURPLE, RED, SKY, BROWN)
# Solid, dashed, dash-dotted; dotted lines are continuous-time ones: lines of one panel that lie on one another stay visible.
STYLES = ("-", "--", "-.")

# A legend's row holds about so many letters over half of a wide page's width, or over a narrow page; what is longer goes
# on in a further row.
_LETTERS_A_ROW, _LETTERS_A_PAGE = 56, 76
_LETTERS_AN_INCH = 12
# What a legend's line and gaps take beside its text, in letters.
_LETTERS_BESIDE = 8

# A logarithmic axis whose ends are apart by less than this factor has a label or two at powers of ten.
_SHORT = 80.0
# Letters by which a title's lines may differ.
_WORD = 8

_STYLE = {
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 11,
    "figure.dpi": 110,
    "font.size": 9.5,
    "grid.alpha": 0.3,
    "legend.framealpha": 0.85,
    "lines.linewidth": 1.6,
    "savefig.bbox": "tight",
}


# Beyond such values, those of a run that diverged, matplotlib places no ticks: its steps overflow.
_LARGEST_DRAWN = 1e100


@contextmanager
def page(path: Path | None, rows: int = 1, columns: int = 1, size: tuple[float, float] = (8.0, 5.0), **layout) -> Iterator:
    """Yield a figure's axes (rows, columns); when the block ends, save the figure at `path` where one is given."""
    with matplotlib.rc_context(), np.errstate(over="ignore", invalid="ignore"):  # the ticks of a run that diverged
        matplotlib.rcdefaults()  # not the reader's own settings: TeX that is not there, pictures of any size
        matplotlib.rcParams.update(_STYLE)
        # A figure of its own, without pyplot: no screen is needed and nothing is left open.
        figure = Figure(figsize=size, layout="constrained")
        yield figure.subplots(rows, columns, squeeze=False, **layout)
        for axes in figure.axes:
            low, high = axes.get_ylim()
            if max(-low, high) > _LARGEST_DRAWN:
                axes.set_ylim(max(low, -_LARGEST_DRAWN), min(high, _LARGEST_DRAWN))
            _few_ticks(axes)
        for text in figure.findobj(Text):
            if "$" in text.get_text() and "\\math" not in text.get_text():
                text.set_parse_math(False)  # a name with dollars is a name, not a formula
        if path is not None:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "Glyph", UserWarning)  # the font's own box stands for what it has not
                figure.savefig(path)


def _few_ticks(axes) -> None:
    """Label a logarithmic axis of less than two decades plainly, at 1, 2 and 5 alone: more would lie on one another."""
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        if axis.get_scale() == "log" and high < _SHORT * low:
            axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
            axis.set_minor_formatter(FuncFormatter(lambda x, _: f"{x:g}" if f"{x:e}"[0] in "25" else ""))


def wrapped(text: str, most: int) -> str:
    """Return a title in lines of about one length, of so many letters at the most."""
    lines = -(-len(text) // most)
    return textwrap.fill(text, min(most, len(text) // lines + _WORD))


def outside_legend(axes, *, narrow: bool = False, **options) -> None:
    """Put a legend above the axes, where it hides no data: in as many rows as the page, or half of it, asks for."""
    handles, labels = axes.get_legend_handles_labels()
    columns = max(1, len(labels))
    room = _LETTERS_A_ROW if narrow else _LETTERS_A_PAGE
    if sum(len(label) + _LETTERS_BESIDE for label in labels) > room:
        columns = max(1, room // (max(map(len, labels)) + _LETTERS_BESIDE))
    axes.legend(handles, labels, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=columns, frameon=False, **options)


def bottom_legend(axes) -> None:
    """Put one panel's legend below the whole page, where it hides no data and makes no page wider."""
    handles, labels = axes.get_legend_handles_labels()
    if not labels:
        return
    room = _LETTERS_AN_INCH * axes.figure.get_figwidth()
    most = max(1, int(room // (max(map(len, labels)) + _LETTERS_BESIDE)))
    rows = -(-len(labels) // most)
    columns = -(-len(labels) // rows)
    axes.figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)


def sides_by_unit(axes, what: str, units: Sequence[str]) -> dict:
    """Return the axes for each unit: of two units, as of a slide beside a hinge, the second has its own on the right."""
    names = list(dict.fromkeys(units))
    sides = dict.fromkeys(names, axes)
    if len(names) == 2:
        sides[names[1]] = axes.twinx()
        sides[names[1]].grid(visible=False)
        sides[names[1]].spines["right"].set_visible(True)
    for unit, side in sides.items():
        shown = ", ".join(names) if len(names) > 2 else unit
        side.set_ylabel(what if shown == "1" else f"{what} [{shown}]")
    return sides


def level_zeros(sides: set) -> None:
    """Bring the zeros of two vertical axes to one height, where both have one."""
    if len(sides) < 2 or any(side.get_yscale() == "log" for side in sides):
        return
    one_sided = all(side.get_ylim()[0] == 0 for side in sides)
    for side in sides:
        size = max(abs(end) for end in side.get_ylim())
        side.set_ylim(0.0 if one_sided else -size, size)
