"""The figure of the solution of a user's optimal-control problem: states and efforts over time."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from linkplan.studies.output.figure import figure_of
from linkplan.studies.output.lines import TIME, Line, plots


def ode_figure(
    title: str, columns: Mapping[str, np.ndarray], n_x: int, limits: Mapping[str, np.ndarray], path: Path | None
) -> Figure:
    """Return the figure of columns (n,): time, then `n_x` states, then efforts, with their limits [low, high] by name."""
    (_, time), *rest = columns.items()
    lines = [Line(name=name, values=values, unit="1", limits=tuple(limits[name])) for name, values in rest]
    panels = [*plots("States", "state", TIME, time, lines[:n_x]), *plots("Efforts", "effort", TIME, time, lines[n_x:])]
    return figure_of(panels, path, title=title, panel_in=(7.0, 2.7))
