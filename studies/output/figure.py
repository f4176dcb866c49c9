"""The plots, planes and bars of a document as one figure of matplotlib, one panel each.

One look for every figure: sizes, grid, and colours that colour-blind readers can tell apart (Okabe & Ito, 2008).
"""

import textwrap
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.text import Annotation, Text
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullFormatter, NullLocator
from matplotlib.transforms import Bbox

from linkplan.studies.output.document import MEASURED, Axis, Bars, Numbers, Plane, Plot, Series
from linkplan.studies.output.figure_spec import FigureSpec, Panel

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
# The steps between matplotlib's ticks overflow at larger values, which a diverged run can have.
_LARGEST_DRAWN = 1e100
_STYLES = {
    "line": {"linestyle": "-"},
    "dash": {"linestyle": "--"},
    "dashdot": {"linestyle": "-."},
    "dots": {"linestyle": ":"},
    "points": {"linestyle": "", "marker": "o", "markersize": 4},
    "steps": {"linestyle": "-", "drawstyle": "steps-post"},
    "cross": {"linestyle": "", "marker": "x", "markersize": 6},
    "star": {"linestyle": "", "marker": "*", "markersize": 13, "markeredgecolor": BLACK},
}
# Letters of a figure's title per inch of its width.
_TITLE_LETTERS_PER_INCH = 10
# Letters of a panel's title and of its legend per inch of its width.
_PANEL_LETTERS_PER_INCH, _LEGEND_LETTERS_PER_INCH = 12, 15
# The gap [pt] between a column's head and the title below it.
_HEAD_GAP_PT = 6
# Letters of a bar's label on a line, letters of labels and of notes on an inch, and the least width of bars [inch].
_BAR_LABEL_LETTERS, _LABEL_LETTERS_PER_INCH, _NOTE_LETTERS_PER_INCH, _LEAST_BARS_IN = 32, 12, 16, 1.5
# The group id of annotations that may move around their pin, and the offsets [pt] of the possible places.
PIN_NAME = "name of a pin"
_AROUND_PIN = ((5, 5), (5, -11), (-14, 5), (-14, -11), (-4, 10), (-4, -16), (9, -3), (-20, -3))
# The share of a bar's row that its spans fill.
_BAR_SHARE = 0.76
# The share of an axis that the name of a limit needs below its line.
_ROOM_BELOW_LIMIT = 0.2


class ShownFigure(Figure):
    """A figure that a notebook shows without pyplot and its choice of a backend."""

    def _repr_png_(self) -> bytes:
        picture = BytesIO()
        self.savefig(picture, format="png")
        return picture.getvalue()


@contextmanager
def page(path: Path | None, rows: int = 1, columns: int = 1, size: tuple[float, float] = (8.0, 5.0), **layout) -> Iterator:
    """Yield a figure's axes (rows, columns); when the block ends, save the figure at `path` if it is given."""
    with matplotlib.rc_context(), np.errstate(over="ignore", invalid="ignore"):  # warnings about the ticks of a diverged run
        matplotlib.rcdefaults()  # without the user's settings, which may need TeX
        matplotlib.rcParams.update(_STYLE)  # pyright: ignore[reportCallIssue, reportArgumentType]  its keys are text
        # A figure without pyplot needs no screen and leaves nothing open.
        figure = ShownFigure(figsize=size, layout="constrained")
        yield figure.subplots(rows, columns, squeeze=False, **layout)
        for axes in figure.axes:
            low, high = axes.get_ylim()
            if max(-low, high) > _LARGEST_DRAWN:
                axes.set_ylim(max(low, -_LARGEST_DRAWN), min(high, _LARGEST_DRAWN))
            _few_ticks(axes)
        for text in figure.findobj(Text):
            if "$" in text.get_text() and "\\math" not in text.get_text():
                text.set_parse_math(False)  # names may have dollar signs
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Glyph", UserWarning)  # missing glyphs are drawn as boxes
            _lay_out(figure)
            if path is not None:
                figure.savefig(path)


def _lay_out(figure: Figure) -> None:
    """Place axes and texts, and remove the layout engine, which would lay out the figure again when it is saved.

    The layout runs twice, because axes of equal units become narrower or lower in the first run.
    """
    equal = any(axes.get_aspect() != "auto" for axes in figure.axes)
    for _ in range(2 if equal else 1):
        figure.get_layout_engine().execute(figure)
    figure.set_layout_engine(None)
    separate_names(figure)


def separate_names(figure: Figure) -> None:
    """Move each name at a pin to the first of eight places around the pin at which it overlaps no other name."""
    names = [text for text in figure.findobj(Annotation) if text.get_gid() == PIN_NAME]
    renderer = FigureCanvasAgg(figure).get_renderer() if names else None
    taken: dict[int, list[Bbox]] = {}
    for name in names:
        others = taken.setdefault(id(name.axes), [])
        best = np.inf
        for place in [name.get_position(), *_AROUND_PIN]:
            name.set_position(place)
            box = name.get_window_extent(renderer).padded(1.5)
            shared = [part for other in others if (part := Bbox.intersection(box, other)) is not None]
            covered = sum(part.width * part.height for part in shared)
            if covered < best:
                best, chosen, own = covered, place, box
        name.set_position(chosen)
        others.append(own)


def _few_ticks(axes) -> None:
    """Widen an axis with constant data, and label a logarithmic axis of few decades with more numbers than powers of ten."""
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        size = max(abs(low), abs(high))
        if high - low < 1e-6 * size:  # a constant: rounding errors are not resolved
            axis.axes.set(**{f"{axis.axis_name}lim": (low - 0.1 * size, high + 0.1 * size)})
        if axis.get_scale() == "log" and low > 0:
            _number_log_axis(axis, low, high)


def _number_log_axis(axis, low: float, high: float) -> None:
    """Label an axis with less than three powers of ten at 1, 2 and 5, or at 1 and 3 if these are many.

    If these are less than three, it is labelled at round numbers.
    """
    digits, decades = [1, 2, 5], 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
    if np.sum((decades >= low) & (decades <= high)) >= 3:
        return
    at = np.outer(decades, digits if high < 100 * low else [1, 3]).ravel()
    at = at[(at >= low) & (at <= high)]
    if len(at) < 3:
        at = np.array(MaxNLocator(nbins=5, steps=[1, 2, 5, 10]).tick_values(low, high))
        axis.set_minor_locator(NullLocator())
    axis.set_major_locator(FixedLocator(at[at > 0].tolist()))
    axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def wrapped(text: str, most: int) -> str:
    """Return a title in lines of about equal length, each with at most `most` letters."""
    lines = -(-len(text) // most)
    return textwrap.fill(text, min(most, len(text) // lines + 8))


def outside_legend(axes, row_letters: int = 56, **options) -> int:
    """Put a legend above the axes, where it hides no data, and return how many rows of `row_letters` it needs."""
    handles, names = axes.get_legend_handles_labels()
    labels = [wrapped(name, row_letters - _LEGEND_MARK_LETTERS) for name in names]
    lines = [line for label in labels for line in label.splitlines()]
    columns = max(1, len(labels))
    if sum(len(label) + _LEGEND_MARK_LETTERS for label in labels) > row_letters:
        columns = max(1, row_letters // (max(map(len, lines)) + _LEGEND_MARK_LETTERS))
    axes.legend(handles, labels, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=columns, frameon=False, **options)
    return -(-len(lines) // columns)


def figure_of(spec: FigureSpec, path: Path | None = None) -> Figure:
    """Return the figure of panels, saved at `path` if it is given."""
    panels, panel_in, title = spec.panels, spec.panel_in, spec.title
    columns = max(1, min(spec.columns, len(panels)))
    rows = max(1, -(-len(panels) // columns))
    size = panel_in[0] * columns, panel_in[1] * rows + 0.4
    named: list[list] = []
    heads_in = np.zeros(rows)
    shared = {"sharex": True, "sharey": "row"} if spec.heads else {}
    with page(path, rows, columns, size, **shared) as axes:
        for k, axis in enumerate(axes.flat):
            panel = panels[k] if k < len(panels) else None
            if panel is None:
                axis.set_visible(False)
                continue
            if callable(panel):
                panel(axis)
                if axis.get_aspect() != "auto" and not any(panels[k + columns :: columns]):
                    axis.set_subplotspec(axis.get_gridspec()[k // columns :, k % columns])  # the empty room below a drawing
            else:
                _DRAWERS[type(panel)](axis, panel)
            width = _width_of(panel, panel_in[0])
            head = _legend(axis, axis.get_title() if callable(panel) else panel.title, named, width)
            heads_in[k // columns] = max(heads_in[k // columns], head)
            if shared:
                axis.label_outer()
        for axis, head in zip(axes[0], spec.heads, strict=False):
            place = {"xytext": (0, 72 * heads_in[0] + _HEAD_GAP_PT), "textcoords": "offset points", "ha": "center"}
            lines = wrapped(head, int(_TITLE_LETTERS_PER_INCH * panel_in[0]))
            axis.annotate(lines, (0.5, 1.0), xycoords="axes fraction", weight="bold", **place)
        figure = axes.flat[0].figure
        figure.set_size_inches(size[0], max(size[1], float(heads_in.sum()) + 1.2 * rows))  # space for titles and curves
        if title:
            figure.suptitle(wrapped(title, int(_TITLE_LETTERS_PER_INCH * size[0])), fontsize=11)
    return figure


def save_figures(figures: Iterable[tuple[str, FigureSpec]], place: Path) -> None:
    """Draw figures into a folder, each as NAME.png."""
    for name, spec in figures:
        figure_of(spec, place / f"{name}.png")


def _width_of(panel: Panel, width_in: float) -> float:
    """Return the width [inch] of a panel's axes; bars need space for labels at their left and notes at their right."""
    if not isinstance(panel, Bars):
        return width_in
    lines = [line for row in panel.rows for line in _bar_label(row.label).splitlines()]
    notes = [row.note for row in panel.rows]
    beside = (
        max(map(len, lines), default=0) / _LABEL_LETTERS_PER_INCH + max(map(len, notes), default=0) / _NOTE_LETTERS_PER_INCH
    )
    return max(_LEAST_BARS_IN, width_in - beside)


def _bar_label(label: str) -> str:
    """Return a bar's label in lines, broken between words only."""
    return "\n".join(textwrap.wrap(label, _BAR_LABEL_LETTERS, break_long_words=False))


def _legend(axis, title: str, named: list[list], width_in: float) -> float:
    """Set the title of a panel `width_in` [inch] wide, and a legend unless a panel in the list `named` has the same one.

    Returns:
        the height of both [inch].
    """
    handles, labels = axis.get_legend_handles_labels()
    looks = [(label, line.get_color(), line.get_linestyle()) for line, label in zip(handles, labels, strict=True)
             if hasattr(line, "get_color")]  # fmt: skip
    own = any(label not in title for label in labels) and looks not in named and axis.get_legend() is None
    rows = outside_legend(axis, int(_LEGEND_LETTERS_PER_INCH * width_in), fontsize=8) if own else 0
    named.append(looks)
    lines = wrapped(title, int(_PANEL_LETTERS_PER_INCH * width_in)) if title else ""
    pad = 6 + 14 * rows
    axis.set_title(lines, fontsize=9.5, pad=pad)
    return (pad + 12 * len(lines.splitlines())) / 72


def draw_plot(axis, plot: Plot) -> None:
    """Draw the lines of a plot, and its limits as dotted lines with their names."""
    for one in plot.series:
        _draw_line(axis, one, plot.x if one.x is None else one.x)
    _set_axes(axis, plot.x_axis, plot.y_axis)
    _draw_limits(axis, plot)


def draw_plane(axis, plane: Plane) -> None:
    """Draw the map and the curves of a plane."""
    heat = plane.heat
    if heat is not None:
        low, high = sorted(heat.ends)
        colours = "RdBu_r" if heat.ends[0] < heat.ends[1] else "RdBu"
        values = _numbers(heat.values)
        look = {"shading": "nearest", "cmap": colours, "vmin": low, "vmax": high}
        image = axis.pcolormesh(_numbers(heat.x), _numbers(heat.y), values, **look)
        axis.figure.colorbar(image, ax=axis, label=wrapped(f"{heat.name} [{heat.unit}]", 30))
    for one in plane.curves:
        if one.look == "area":
            axis.fill(_numbers(one.x), _numbers(one.y), color=_colour(one), alpha=0.2, linewidth=0, label=one.name or None)
        else:
            _draw_line(axis, one, one.x)
    _set_axes(axis, plane.x_axis, plane.y_axis)
    if plane.equal:
        axis.set_aspect("equal")


def draw_bars(axis, bars: Bars) -> None:
    """Draw bars one below the other, with their notes at the right edge."""
    shown = set()
    for k, row in enumerate(bars.rows):
        height = _BAR_SHARE / max(1, len(row.spans))
        for i, span in enumerate(row.spans):
            at = k - _BAR_SHARE / 2 + (i + 0.5) * height
            label = None if span.name in shown else span.name
            shown.add(span.name)
            axis.barh(at, span.end - span.start, height, left=span.start, color=_colour(span), label=label)
            if span.low is not None and span.high is not None:
                off = np.abs([[span.end - span.low], [span.high - span.end]])
                axis.errorbar(span.end, at, xerr=off, fmt="none", ecolor=GREY, elinewidth=0.9, capsize=1.5)
        axis.annotate(row.note, (1.01, k), xycoords=axis.get_yaxis_transform(), va="center", fontsize=7.5)
    axis.axvline(bars.line, color=BLACK, linewidth=0.9, label=bars.line_name or None)
    axis.set_yticks(range(len(bars.rows)), [_bar_label(row.label) for row in bars.rows])
    axis.set_ylim(len(bars.rows) - 0.4, -0.6)
    axis.grid(visible=False, axis="y")
    axis.tick_params(axis="y", length=0)
    axis.xaxis.get_major_locator().set_params(nbins=5)
    axis.set_xlabel(_labelled(bars.axis))


_DRAWERS: dict[type, Callable] = {Plot: draw_plot, Plane: draw_plane, Bars: draw_bars}


def _draw_line(axis, one: Series, x: Numbers | None) -> None:
    look = {"linewidth": one.width} | _STYLES[one.look]
    axis.plot(
        _numbers(x),
        _numbers(one.y),
        color=_colour(one),
        label=None if one.name.endswith(MEASURED) else one.name or None,
        **look,
    )


def _draw_limits(axis, plot: Plot) -> None:
    ends = [float(one.y[-1]) for one in plot.series if len(one.y) and one.y[-1] is not None]
    for limit in plot.limits:
        axis.axhline(limit.value, color=GREY, linestyle=":", linewidth=1.2)
        scaled = np.log10 if plot.y_axis.log else float
        low, high, at = (scaled(value) for value in (*axis.get_ylim(), limit.value))
        # The name stands above its line, or below if the curves end above it and there is room.
        below = at - low > _ROOM_BELOW_LIMIT * (high - low) and bool(ends) and min(ends) >= limit.value
        place = {"xycoords": axis.get_yaxis_transform(), "ha": "right", "va": "top" if below else "bottom"}
        place |= {"xytext": (0, -3 if below else 0), "textcoords": "offset points"}
        text = axis.annotate(f"{limit.name} {limit.value:.4g}", (0.995, limit.value), color="#595959", fontsize=7, **place)
        text.set_path_effects([withStroke(linewidth=2.5, foreground="white")])  # in front of curves


def _set_axes(axis, *both: Axis) -> None:
    for name, one in zip("xy", both, strict=True):
        axis.set(**{f"{name}label": _labelled(one)} | ({f"{name}scale": "log"} if one.log else {}))
        if one.ends is not None:
            axis.set(**{f"{name}lim": one.ends})


def _labelled(axis: Axis) -> str:
    return axis.label if axis.unit == "1" else f"{axis.label} [{axis.unit}]"


def _colour(one) -> str:
    return BLACK if one.colour is None else SERIES[one.colour % len(SERIES)]


def _numbers(values: Sequence | None) -> np.ndarray:
    """Return numbers, or rows of numbers, as an array with NaN where there is no value."""
    return np.array(values, dtype=float)
