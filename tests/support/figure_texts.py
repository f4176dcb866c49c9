"""The texts of a figure as they are drawn: those that overlap, are cut off or are missing."""

from dataclasses import dataclass
from itertools import combinations

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

# Two texts on one line are read as one if less than this is between them [px], at 110 px to the inch.
APART_PX = 2.0
# Boxes of two lines have some white at the top and the bottom, by which they may overlap [px].
WHITE_PX = 2.0
# A title above a figure of curves has at most this many lines.
MOST_TITLE_LINES = 3
# Numbers on an axis, by its scale: fewer do not tell the size of a value.
FEWEST_NUMBERS = {"linear": 2, "log": 3}


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawn:
    """A text of a figure with its box [px]."""

    text: str
    box: Bbox


def drawn_texts(figure: Figure) -> list[Drawn]:
    """Return the texts that a figure draws. Texts of ticks beyond an axis are not drawn, those of legends are."""
    found, draw = [], Text.draw

    def noted(text: Text, renderer, *more: object, **others: object) -> None:
        if text.get_visible() and text.get_text().strip():
            found.append(Drawn(text=text.get_text(), box=Text.get_window_extent(text, renderer)))
        draw(text, renderer, *more, **others)

    Text.draw = noted
    try:
        FigureCanvasAgg(figure).draw()
    finally:
        Text.draw = draw
    return found


def text_faults(figure: Figure) -> list[str]:
    """Return a sentence on each text of a figure that is cut off, lies on another text, or is missing."""
    texts = drawn_texts(figure)
    faults = [f"'{one.text}' is cut off" for one in texts if not _within(one.box, figure.bbox)]
    for one, other in combinations(texts, 2):
        beside = min(one.box.x1, other.box.x1) - max(one.box.x0, other.box.x0)
        above = min(one.box.y1, other.box.y1) - max(one.box.y0, other.box.y0)
        if beside > -APART_PX and above > WHITE_PX:
            faults.append(f"'{one.text}' lies on '{other.text}'")
    title = figure.get_suptitle()
    if len(title.splitlines()) > MOST_TITLE_LINES:
        faults.append(f"a title of {len(title.splitlines())} lines: '{title}'")
    return faults + [fault for axes in figure.axes if axes.get_visible() for fault in _missing(axes)]


def _within(box: Bbox, page: Bbox) -> bool:
    return bool(box.x0 > -1 and box.y0 > -1 and box.x1 < page.x1 + 1 and box.y1 < page.y1 + 1)


def _outermost(axes, name: str):
    """Return the axes with the numbers of an axis: the lowest one in a column that shares x, the first in a row for y."""
    alike = getattr(axes, f"get_shared_{name}_axes")().get_siblings(axes)
    if len(alike) == 1:
        return axes
    own = axes.get_subplotspec()
    if name == "x":
        column = [one for one in alike if one.get_subplotspec().colspan == own.colspan]
        return max(column, key=lambda one: one.get_subplotspec().rowspan.start)
    row = [one for one in alike if one.get_subplotspec().rowspan == own.rowspan]
    return min(row, key=lambda one: one.get_subplotspec().colspan.start)


def _missing(axes) -> list[str]:
    """Return the labels and numbers that axes lack; bars have names in place of numbers, and a colour bar one axis."""
    faults = []
    for axis in (_outermost(axes, "x").xaxis, _outermost(axes, "y").yaxis):
        low, high = sorted(axis.get_view_interval())
        numbers = {
            float(place): label.get_text()
            for minor in (False, True)
            for place, label in zip(axis.get_ticklocs(minor=minor), axis.get_ticklabels(minor=minor), strict=True)
            if label.get_text() and low <= place <= high
        }
        if any(text[:1].isalpha() for text in numbers.values()) or (axes.get_label() == "<colorbar>" and not numbers):
            continue
        name = axis.get_label_text()
        if not name:
            faults.append(f"a {axis.axis_name}-axis without a label")
        if len(numbers) < FEWEST_NUMBERS[axis.get_scale()]:
            faults.append(f"{name}: a {axis.get_scale()} axis from {low:.3g} to {high:.3g} with the numbers {list(numbers)}")
    return faults
