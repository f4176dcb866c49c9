"""The figure of a decomposition: a waterfall chart of the causes for each tracker."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from linkplan.studies.decompose.decompose import Decomposition
from linkplan.studies.decompose.ladder import RUNGS
from linkplan.studies.decompose.shares import Shares
from linkplan.studies.output.drawing import BLUE, GREY, ORANGE, page


def decomposition_figure(found: Decomposition, path: Path | None = None) -> Figure:
    """Return the figure of every tracker's parts, saved at `path` if given; each panel has its own scale."""
    panels = [(one.name, unit, shares) for one in found.trackers for unit, shares in one.shares.items()]
    columns = max(1, min(3, len(panels)))
    rows = max(1, -(-len(panels) // columns))
    with page(path, rows, columns, (1.5 + 3.2 * columns, 2.5 * rows + 0.5), sharey=True) as axes:
        for axis, (name, unit, shares) in zip(axes.flat, panels, strict=False):
            draw_parts(axis, shares, unit)
            axis.set_title(f"{name}: {shares.rms:.3g} {unit} rms")
        for axis in axes.flat[len(panels) :]:
            axis.set_visible(False)
        figure = axes.flat[0].figure
        n = found.experiment.n
        figure.suptitle(f"{found.plan.problem.name}: where the error comes from, {n} machine{'s' if n > 1 else ''}")
    return figure


def draw_parts(axis, shares: Shares, unit: str) -> None:
    """Draw the parts of a rms error as a waterfall of bars, with the total at the bottom."""
    ends = np.cumsum(shares.parts)
    starts = ends - shares.parts
    labels = [*(text.partition(":")[0] for text in RUNGS.values()), "rms error"]
    places = np.arange(len(labels))
    colours = [ORANGE if part >= 0 else BLUE for part in shares.parts]
    axis.barh(places, [*shares.parts, shares.rms], left=[*starts, 0.0], color=[*colours, GREY], height=0.65)
    axis.vlines(ends, places[:-1], places[1:], color=GREY, linewidth=0.8)
    low, high = min(0.0, float(ends.min())), max(shares.rms, float(ends.max()))
    width = max(high - low, 1e-300)
    right = np.maximum([*starts, 0.0], [*ends, shares.rms])
    for place, value, end in zip(places, [*shares.parts, shares.rms], right, strict=True):
        if abs(value) > 1e-3 * width:
            axis.annotate(f"{value:.2g}", (end, place), (3, 0), textcoords="offset points", va="center", fontsize=8)
    axis.set_xlim(low - 0.02 * width, high + 0.28 * width)  # with space for the numbers
    axis.set_yticks(places, labels)
    axis.set_ylim(len(labels) - 0.5, -0.5)
    axis.grid(visible=False, axis="y")
    axis.axvline(0.0, color="black", linewidth=0.8)
    axis.set_xlabel(f"part of the rms error [{unit}]")
