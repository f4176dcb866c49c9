"""The quantities along a path of `linkplan check` as plots, and the figures of a path and of a mechanism's reach."""

from collections.abc import Callable, Sequence

import numpy as np

from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.reach import Reach, toggles
from linkplan.studies.check.inspection import Inspection
from linkplan.studies.check.kinematic_loop_report import KinematicLoopPath, measure, most_poses, swept, thinned
from linkplan.studies.check.path_quantities import LOG_PLOTS, PLOTS, QUANTITIES, REACH_PLOTS, WEIGHT, shown_curves
from linkplan.studies.output.document import Axis, Plot
from linkplan.studies.output.draw_bodies import draw_poses
from linkplan.studies.output.figure import GREY, RED, draw_plot
from linkplan.studies.output.figure_spec import FigureSpec, one_screen
from linkplan.studies.output.lines import TIME, Line, plots

# With more coordinates, the paths of a page are collapsed, and the plots of a path show only its own coordinate.
MAX_COORDINATES_DRAWN = 6
# Number of coordinates in the figure of a mechanism. If there are not more, each also has its own figure. The page has all.
MAX_FIGURES = 3


def path_figure(path: KinematicLoopPath, reaches: Sequence[Reach]) -> FigureSpec:
    """Return the figure of a path: the mechanism at seven poses, and the plots of its quantities."""
    poses = path.poses[np.linspace(0, len(path.poses) - 1, num=7).astype(int)]
    if path.coordinate is not None:
        poses = np.vstack([poses, path.mechanism.home])
    last = "the end" if path.coordinate is None else "home"
    panels: list = [lambda axes: draw_poses(axes, path.mechanism, poses, last), *path_plots(path)]
    if path.coordinate is not None:
        panels[1:] = [_marked(plot, path.mechanism, reaches[path.coordinate]) for plot in panels[1:]]
    title = f"{path.mechanism.name}: along {path.title}, at rest"
    columns = 2 if len(panels) <= 6 else 3 if len(panels) <= 9 else 4
    size = one_screen(len(panels), columns, (5.3, 3.3))
    return FigureSpec(panels=panels, title=title, columns=columns, panel_in=size)


def inspection_figure(found: Inspection) -> FigureSpec:
    """Return the figure of a mechanism over the reach of its first three coordinates.

    The figure has the mechanism, its dependent joints, the reduced inertia, and the holding effort. With at most three
    coordinates, each also has a figure loop-N.png. Spins of rods about their own axis are left out.
    """
    mechanism = found.mechanism
    actuated = [can for can in found.reaches if mechanism.actuated[can.coordinate]]
    reaches = (actuated or found.reaches)[:MAX_FIGURES]
    rows: list[list] = []
    for can in reaches:
        poses = thinned(swept(mechanism, can), most_poses(mechanism))
        path_of_reach = measure(mechanism, poses, "reach", coordinate=can.coordinate)
        plots_of_reach = [plot for plot in path_plots(path_of_reach) if plot.title.startswith(REACH_PLOTS)]
        rows.append([lambda axes, can=can: draw_poses(axes, mechanism, _drawn_poses(mechanism, can), "home")])
        rows[-1] += [_marked(plot, mechanism, can) for plot in plots_of_reach]
    names = [mechanism.joints[mechanism.independent[can.coordinate]].name for can in reaches]
    others = "" if mechanism.dof == 1 else f": {' then '.join(names)} each over its reach, the other coordinates at home"
    columns = 2 if len(rows) <= 1 else min(4, max(map(len, rows)))  # the panels of each coordinate begin a new row
    panels = [panel for row in rows for panel in (*row, *[None] * (-len(row) % columns))]
    size = one_screen(len(panels), columns, (5.3, 3.6))
    return FigureSpec(panels=panels, title=f"{mechanism.name}{others}", columns=columns, panel_in=size)


def _marked(plot: Plot, mechanism: Mechanism, can: Reach) -> Callable[..., None]:
    """Return the panel of a plot over a reach, with its singular poses and turning points."""

    def draw(axes) -> None:
        draw_plot(axes, plot)
        mark_turning(axes, mechanism, can)
        axes.set_title(plot.title)

    return draw


def _drawn_poses(mechanism: Mechanism, can: Reach) -> np.ndarray:
    """Return five poses over a reach (over 0.8 periods from home of a joint that turns continuously), and the home pose."""
    poses = can.poses
    if can.period is not None:
        travel = poses[:, mechanism.independent[can.coordinate]] - can.home
        poses = poses[(travel >= 0) & (travel <= 0.8 * can.period)]
    return np.vstack([poses[np.linspace(0, len(poses) - 1, 5).astype(int)], mechanism.home])


def over(path: KinematicLoopPath) -> tuple[Axis, np.ndarray]:
    """Return the label and values (n,) of a path's horizontal axis: the coordinate, or the time of a motion."""
    if path.coordinate is None and path.time_s is not None:
        return Axis(label="time of the path", unit="s") if path.mechanism.dof > 1 else TIME, path.time_s
    column = path.coordinate or 0
    joint = path.mechanism.independent_joints[column]
    return Axis(label=joint.name, unit=joint.unit), joint.shown(path.positions[:, column])


def rising_order(x: np.ndarray) -> np.ndarray:
    """Return the indices (n,) that sort the values of a path."""
    return np.arange(len(x)) if np.all(np.diff(x) > 0) else np.argsort(x, kind="stable")


def path_plots(path: KinematicLoopPath, group: str = "") -> list[Plot]:
    """Return the plots of ratios, inertias, efforts and forces along a path."""
    mechanism, (axis, x) = path.mechanism, over(path)
    order = rising_order(x)
    x = x[order]
    many = mechanism.dof > MAX_COORDINATES_DRAWN
    shown = mechanism.channels if path.coordinate is None or not many else (path.coordinate,)
    drawn: dict[str, list[Line]] = {title: [] for title in PLOTS}
    # The weight alone is drawn only where springs or constant forces hold, too.
    rounding = ROUNDING_SHARE * max(np.abs(path.needed).max(initial=0.0), np.finfo(float).tiny)
    alone = bool(np.abs(path.needed - path.gravity_effort).max() <= rounding)
    for quantity in (one for one in QUANTITIES if one.plot and not (one is WEIGHT and alone)):
        for curve in shown_curves(path, quantity, shown):
            name, values = quantity.line.format(*curve.names), curve.values[order]
            ends = {name: values} if values.ndim == 1 else {f"{name}, least": values[:, 0], f"{name}, most": values[:, 1]}
            drawn[quantity.plot] += [Line(name=key, values=x, unit=curve.unit) for key, x in ends.items()]
    found = []
    for title, lines in drawn.items():
        log = title in LOG_PLOTS and _spans_much(lines)
        found += plots(title, PLOTS[title], axis, x, lines, group=group, log=log, ends=None if log else inner_ends(lines))
    return found


def _spans_much(lines: Sequence[Line]) -> bool:
    """Tell if the values are positive and some line changes by more than a factor of five."""
    rows = [line.values[np.isfinite(line.values)] for line in lines]
    return all(len(row) and row.min() > 0 for row in rows) and any(row.max() > 5 * row.min() for row in rows)


def inner_ends(lines: Sequence[Line]) -> tuple[float, float] | None:
    """Return the ends of an axis for the inner 90 % of the values if the whole range is three times as high; otherwise None.

    Quantities become infinite at a singular pose. With the whole range, the rest of the line would look flat.
    """
    if len({line.unit for line in lines}) != 1:
        return None
    known_rows = [row for line in lines if len(row := line.values[np.isfinite(line.values)])]
    if not known_rows:
        return None
    low, high = min(float(row.min()) for row in known_rows), max(float(row.max()) for row in known_rows)
    inner = [np.quantile(row, (0.05, 0.95)) for row in known_rows]
    least, most = float(np.min(inner)), float(np.max(inner))
    if not high - low > 3 * (most - least) > 0:
        return None
    room = 0.3 * (most - least)
    return least - room, most + room


def mark_turning(axes, mechanism: Mechanism, can: Reach) -> None:
    """Draw the singular poses of a reach as red dotted lines and the turning points of dependent joints as grey ones."""
    joint = mechanism.joints[mechanism.independent[can.coordinate]]
    left, right = axes.get_xlim()
    labelled = set()
    for words, colour, positions in (
        ("singular pose", RED, can.singular),
        ("a joint turns back", GREY, [position for _, position in toggles(mechanism, can.coordinate)]),
    ):
        for position in positions:
            if left <= joint.shown(position) <= right:  # only one turn of a joint is plotted
                label = None if words in labelled else words
                axes.axvline(joint.shown(position), color=colour, linestyle=":", linewidth=1.2, label=label)
                labelled.add(words)
