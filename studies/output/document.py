"""A report as a document: sections of blocks of JSON values, independent of their presentation.

Every number has the unit given with it. Names come from models and are always treated as text. In JSON, the kind of a block
is its class in small letters.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from msgspec import Struct

from linkplan.studies.output.numbers import significant

Numbers = Sequence[float | None]  # None for a missing value
# The suffix of the name of measured dots. They share the legend entry of the line whose name precedes the suffix.
MEASURED = ", measured"
# The colours of causes that increase a figure, decrease it, or interact with others; the same in all charts.
RAISING_COLOUR, LOWERING_COLOUR, TOTAL_COLOUR = 1, 0, 5

Cell = bool | int | float | str | None


class NumberText(str):
    """A cell whose text has its own digits, such as "0.12 ± 0.01".

    `numbers` are those that a frame has in its place, by the words that are appended to the column's head: "" for none.
    """

    numbers: Mapping[str, float]

    @classmethod
    def of(cls, text: str, *numbers: float, words: Sequence[str] = ("",)) -> "NumberText":
        """Return the text of numbers with their words."""
        found = cls(text)
        found.numbers = dict(zip(words, map(float, numbers), strict=True))
        return found


def _same_length(what: str, values: Sequence, of: str, others: Sequence) -> None:
    """Raise a ValueError if the lengths differ, which is a programming error."""
    if len(values) != len(others):
        raise ValueError(f"{what} has {len(values)} values for {len(others)} {of}")


class Text(Struct, tag_field="kind", tag=str.lower, frozen=True, kw_only=True, eq=False):
    """A paragraph. `tone` is "plain", "good", "bad" or "note". `brief` replaces it in a summary; "" omits it."""

    text: str
    tone: str = "plain"
    brief: str | None = None


class Facts(Struct, tag_field="kind", tag=str.lower, frozen=True, kw_only=True, eq=False):
    """Short facts: (label, value with its unit). `brief` has the facts for a summary, if they are fewer."""

    rows: Sequence[tuple[str, str]]
    brief: Sequence[tuple[str, str]] | None = None


class Table(Struct, tag_field="kind", tag=str.lower, frozen=True, kw_only=True, eq=False):
    """Rows under columns (head, unit); a cell is a number, a word, True or False, or None. `title` may be empty.

    `brief` has the rows of a summary, if they are fewer; without any, a summary leaves the table out.
    """

    title: str
    columns: Sequence[tuple[str, str]]
    rows: Sequence[Sequence[Cell]]
    brief: Sequence[Sequence[Cell]] | None = None

    def __post_init__(self) -> None:
        for row in (*self.rows, *(self.brief or ())):
            _same_length(f"a row of table '{self.title}'", row, "columns", self.columns)


def table_of(
    title: str,
    heads: Sequence[str | tuple[str, str]],
    rows: Sequence[Sequence],
    digits: int = 4,
    brief: Sequence[Sequence] | None = None,
) -> Table:
    """Return a table of raw values.

    Args:
        title: of the table; it may be empty.
        heads: like "phase margin [deg]", or (head, unit) for the name of a part of a model, which may have brackets.
        rows: of cells; numbers are rounded, and numbers that are not finite become None.
        digits: significant digits of numbers.
        brief: the rows of a summary, if they are fewer.
    """
    columns = []
    for head in heads:
        text, bracket, unit = head.partition(" [") if isinstance(head, str) else (head[0], head[1], head[1])
        columns.append((text, unit.removesuffix("]") if bracket else ""))
    cells = [[_cell(cell, digits) for cell in row] for row in rows]
    few = None if brief is None else [[_cell(cell, digits) for cell in row] for row in brief]
    return Table(title=title, columns=columns, rows=cells, brief=few)


def _cell(value: Any, digits: int) -> Cell:
    if value is None or isinstance(value, bool | int | str):
        return value
    kind = getattr(value, "dtype", None)
    return bool(value) if kind is not None and kind.kind == "b" else significant(float(value), digits)


class Item(Struct, frozen=True, kw_only=True, eq=False):
    """One line of a checklist: the worst value, its limit, their unit, and the instant [s] of the worst value."""

    label: str
    passed: bool | None  # None without a limit
    worst: float | None = None
    limit: float | None = None
    unit: str = ""
    instant_s: float | None = None


class Checklist(Struct, tag_field="kind", tag=str.lower, frozen=True, kw_only=True, eq=False):
    """Items with their verdicts; an item with an instant moves the cursor of `group` there."""

    title: str
    group: str
    items: Sequence[Item]


class Axis(Struct, frozen=True, kw_only=True, eq=False):
    """An axis: label, unit ("1" for none), logarithmic or linear, and its ends if they differ from those of the data."""

    label: str
    unit: str
    log: bool = False
    ends: tuple[float, float] | None = None


class Series(Struct, frozen=True, kw_only=True, eq=False):
    """A line over the x of a plot or over its own x, or a curve in a plane. `colour` counts from 0.

    `look` is "line", "dash", "dots", "points", or "steps", in which a value remains until the next x; for a curve also
    "cross", "star" or "area" (filled, closed). Without a colour, the line has the text's colour. A line without a name has
    no entry in the legend.
    """

    name: str
    y: Numbers
    x: Numbers | None = None
    look: str = "line"
    colour: int | None = 0
    width: float = 1.6


class DrawnLimit(Struct, frozen=True, kw_only=True, eq=False):
    """A limit drawn across a plot, in the unit of its vertical axis."""

    name: str
    value: float


class Plot(Struct, tag_field="kind", tag=str.lower, frozen=True, kw_only=True, eq=False):
    """Quantities over a common increasing x (n,). Plots of one `group` share a cursor; a plot without a group shares none.

    For a periodic motion, the cursor's position is taken modulo `period`.
    """

    title: str
    group: str
    x_axis: Axis
    y_axis: Axis
    x: Numbers
    series: Sequence[Series]
    limits: Sequence[DrawnLimit] = ()
    period: float | None = None

    def __post_init__(self) -> None:
        for one in self.series:
            _same_length(f"'{one.name}' in plot '{self.title}'", one.y, "places", self.x if one.x is None else one.x)


class Heat(Struct, frozen=True, kw_only=True, eq=False):
    """Values (n_y, n_x) over a grid: low values are blue, high values red, between `ends`; None is left blank."""

    name: str
    unit: str
    x: Numbers
    y: Numbers
    values: Sequence[Numbers]
    ends: tuple[float, float]

    def __post_init__(self) -> None:
        _same_length(f"map '{self.name}'", self.values, "rows", self.y)
        for row in self.values:
            _same_length(f"a row of map '{self.name}'", row, "columns", self.x)


class Plane(Struct, tag_field="kind", tag=str.lower, frozen=True, kw_only=True, eq=False):
    """Curves in a plane, each with its own points: a phase plane, a Nyquist curve, a map of gains.

    `track` is the index of the curve along which a dot moves with the cursor of `group`, at `track_times` (n,).
    `equal` gives both axes one scale.
    """

    title: str
    x_axis: Axis
    y_axis: Axis
    curves: Sequence[Series]
    heat: Heat | None = None
    equal: bool = False
    group: str = ""
    track: int | None = None
    track_times: Numbers = ()
    period: float | None = None

    def __post_init__(self) -> None:
        for one in self.curves:
            _same_length(f"curve '{one.name}'", one.y, "places", one.x or ())


class Span(Struct, frozen=True, kw_only=True, eq=False):
    """A part of a bar, from `start` to `end`; `low` and `high` are the ends of the interval around `end`, if any."""

    name: str
    start: float
    end: float
    colour: int | None = 0
    low: float | None = None
    high: float | None = None


class Bar(Struct, frozen=True, kw_only=True, eq=False):
    """A row of a bar chart: its name, its parts one below the other, and a note at its end."""

    label: str
    spans: Sequence[Span]
    note: str = ""


class Bars(Struct, tag_field="kind", tag=str.lower, frozen=True, kw_only=True, eq=False):
    """Horizontal bars on one axis. They start at `line`; `note_name` is the heading of their notes."""

    title: str
    axis: Axis
    rows: Sequence[Bar]
    line: float = 0.0
    line_name: str = ""
    note_name: str = ""


class Shape(Struct, frozen=True, kw_only=True, eq=False):
    """A convex shape in the frame of its body: points, flat, thickened by `radius` [m].

    In a plane the points are the corners of its outline, in order. In space, `faces` are the indices of each face's
    corners, counterclockwise seen from outside. `look` is "geom", "payload" or "arm".
    """

    points: Numbers
    radius: float = 0.0
    faces: Sequence[Sequence[int]] = ()
    look: str = "geom"


class Body(Struct, frozen=True, kw_only=True, eq=False):
    """A body of an animation: its pins at every frame, flattened to (n_frames, n_pins * dimension) [m], and its shapes.

    `places` has the body's frame at every frame of the animation, or once for a body at rest: position [m], then cosine and
    sine of its angle in a plane, or its quaternion in space. Bodies of larger `depth` [m] are nearer to the eye.
    `sites` are points in the body's frame by name. `colour` is "c0" to "c9" of the page's series, or "#rrggbb".
    """

    name: str
    fixed: bool
    colour: str = ""
    n_pins: int
    points: Sequence[Numbers]
    places: Sequence[Numbers] = ()
    shapes: Sequence[Shape] = ()
    sites: Sequence[tuple[str, Numbers]] = ()
    depth: float = 0.0


class Mark(Struct, frozen=True, kw_only=True, eq=False):
    """The drawing of an actuator's effort: an "arc" about an axis, an "arrow" along an axis, or a "line" (a tendon).

    `at` is the position (n_frames, dimension) [m]; for a line, each row holds all its points. `axis` holds unit vectors of
    the same shape; an arc in a plane has the third component only, and a line has no axis.
    """

    shape: str
    at: Sequence[Numbers]
    axis: Sequence[Numbers]


class Drive(Struct, frozen=True, kw_only=True, eq=False):
    """An actuator of an animation: its effort (n_frames,) [`unit`], its limits, and its marks, if it has any."""

    name: str
    unit: str
    marks: Sequence[Mark]
    effort: Numbers
    limits: tuple[float | None, float | None]


class Ghost(Struct, frozen=True, kw_only=True, eq=False):
    """The same bodies at the same frames in another motion, such as a tracked one, and the actuators in this motion."""

    name: str
    bodies: Sequence[Body]
    drives: Sequence[Drive] = ()


class Animation(Struct, tag_field="kind", tag=str.lower, frozen=True, kw_only=True, eq=False):
    """A mechanism in motion over times (n_frames,) [`unit`]: in its plane (`dimension` 2) or in space (3).

    `labels` are the names and positions of pins and sites, (n_frames, dimension) each; `paths` are the positions of named
    sites; `axes` are the names of the two directions of the plane. `floors` are the heights of horizontal planes [m].
    """

    title: str
    group: str
    dimension: int
    axes: tuple[str, str]
    times: Numbers
    bodies: Sequence[Body]
    ghosts: Sequence[Ghost] = ()
    drives: Sequence[Drive] = ()
    labels: Sequence[tuple[str, Sequence[Numbers]]] = ()
    paths: Sequence[tuple[str, Sequence[Numbers]]] = ()
    planned: str = "planned"
    period: float | None = None
    unit: str = "s"
    floors: Numbers = ()


class Code(Struct, tag_field="kind", tag=str.lower, frozen=True, kw_only=True, eq=False):
    """Text to copy, for example a problem file."""

    title: str
    text: str


Block = Text | Facts | Table | Checklist | Plot | Plane | Bars | Animation | Code


class Section(Struct, frozen=True, kw_only=True, eq=False):
    """Blocks under a title. A section of `depth` 2 belongs to the last section of depth 1.

    A collapsed section opens on demand, together with the deeper sections after it.
    """

    title: str
    blocks: Sequence[Block]
    depth: int = 1
    folded: bool = False


class Report(Struct, frozen=True, kw_only=True, eq=False):
    """A whole document: title, verdict, software versions, and its sections in order."""

    title: str
    verdict: str
    passed: bool | None  # None without a verdict
    versions: Mapping[str, str]
    sections: Sequence[Section]
