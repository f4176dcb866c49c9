"""One look for every figure: sizes, grid, and colours that colour-blind readers can tell apart (Okabe & Ito, 2008)."""

import textwrap
import warnings
from collections.abc import Iterator
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
SERIES = (BLUE, ORANGE, GREEN, PURPLE, RED, SKY, BROWN)
# The width of a legend's line and gaps, in letters.
_LEGEND_MARK_LETTERS = 8

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
}


# The steps between matplotlib's ticks overflow at larger values, as in a diverged run.
_LARGEST_DRAWN = 1e100


@contextmanager
def page(path: Path | None, rows: int = 1, columns: int = 1, size: tuple[float, float] = (8.0, 5.0), **layout) -> Iterator:
    """Yield a figure's axes (rows, columns); when the block ends, save the figure at `path` if it is given."""
    with matplotlib.rc_context(), np.errstate(over="ignore", invalid="ignore"):  # the ticks of a diverged run
        matplotlib.rcdefaults()  # without the user's settings, which may need TeX
        matplotlib.rcParams.update(_STYLE)  # pyright: ignore[reportCallIssue, reportArgumentType]  its keys are text
        # A figure without pyplot needs no screen and leaves nothing open.
        figure = Figure(figsize=size, layout="constrained")
        yield figure.subplots(rows, columns, squeeze=False, **layout)
        for axes in figure.axes:
            low, high = axes.get_ylim()
            if max(-low, high) > _LARGEST_DRAWN:
                axes.set_ylim(max(low, -_LARGEST_DRAWN), min(high, _LARGEST_DRAWN))
            _few_ticks(axes)
        for text in figure.findobj(Text):
            if "$" in text.get_text() and "\\math" not in text.get_text():
                text.set_parse_math(False)  # names may have dollar signs
        if path is not None:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "Glyph", UserWarning)  # missing glyphs are drawn as boxes
                figure.get_layout_engine().execute(figure)
                figure.set_layout_engine(None)  # a figure that has an engine is drawn twice when it is saved
                figure.savefig(path)


def _few_ticks(axes) -> None:
    """Widen an axis of a constant, and label a logarithmic axis of less than two decades at 1, 2 and 5 only."""
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        size = max(abs(low), abs(high))
        if high - low < 1e-6 * size:  # a constant: rounding errors are not resolved
            axis.axes.set(**{f"{axis.axis_name}lim": (low - 0.1 * size, high + 0.1 * size)})
        if axis.get_scale() == "log" and high < 80 * low:
            axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
            axis.set_minor_formatter(FuncFormatter(lambda x, _: f"{x:g}" if f"{x:e}"[0] in "25" else ""))


def wrapped(text: str, most: int) -> str:
    """Return a title in lines of about equal length, of at most `most` letters."""
    lines = -(-len(text) // most)
    return textwrap.fill(text, min(most, len(text) // lines + 8))


def outside_legend(axes, *, narrow: bool = False, row_letters: int | None = None, **options) -> int:
    """Put a legend above the axes, where it hides no data, and return how many rows it needs.

    A row has `row_letters`; by default 76 letters over the width of a page, or 56 over half of a wide page if `narrow`.
    """
    handles, labels = axes.get_legend_handles_labels()
    columns = max(1, len(labels))
    row_letters = row_letters or (56 if narrow else 76)
    if sum(len(label) + _LEGEND_MARK_LETTERS for label in labels) > row_letters:
        columns = max(1, row_letters // (max(map(len, labels)) + _LEGEND_MARK_LETTERS))
    axes.legend(handles, labels, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=columns, frameon=False, **options)
    return -(-len(labels) // columns)
