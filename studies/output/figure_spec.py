"""The specification of a figure: panels, title and size. `output/figure.py` draws it; this file does not load matplotlib."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain, zip_longest

from linkplan.studies.output.document import Bars, Block, Plane, Plot

# A panel: a block of a document, a function of an Axes for a drawing of a single study, or None for an empty place.
Panel = Plot | Plane | Bars | Callable[..., None] | None


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class FigureSpec:
    """Panels row by row, `columns` of them side by side, under a title; `panel_in` is width and height of each [inch].

    `heads` are the columns' own titles, one for each case. A row then has one quantity in all cases: its panels share the
    vertical axis, and all panels the horizontal one.
    """

    panels: Sequence[Panel]
    title: str = ""
    columns: int = 1
    heads: Sequence[str] = ()
    panel_in: tuple[float, float] = (6.0, 3.3)


def panels_of(blocks: Sequence[Block]) -> list[Panel]:
    """Return the blocks that can be drawn as a panel."""
    return [block for block in blocks if isinstance(block, Plot | Plane | Bars)]


def side_by_side(*columns: Sequence[Panel]) -> list[Panel]:
    """Return the panels of several columns, row by row."""
    return list(chain.from_iterable(zip_longest(*columns)))


def one_screen(n_panels: int, columns: int, panel_in: tuple[float, float]) -> tuple[float, float]:
    """Return the width and height of a panel [inch] with which a figure is at most one screen high (1,080 pixels)."""
    rows = -(-n_panels // columns)
    return panel_in[0], min(panel_in[1], 9.0 / max(1, rows))
