"""The figure of an experiment: how each tracker's figures are distributed over the machines."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from linkplan.studies.experiment.metrics import Metric
from linkplan.studies.output.drawing import SERIES, TRACKER_COLOURS, bottom_legend, page

# Laws that come to the same where no limit is met, or far from a singular pose, and so lie on another's line.
_DASHED = {"ct": (0, (4, 4)), "mpc": (0, (4, 4))}
# What is shown of the metrics that begin so, in this order.
_SHOWN = ("rms_error", "max_error", "final_error", "peak_effort", "chatter", "saturated_share")
# Logarithmic axes over less than this factor have 1, 2 and 5 of each decade labelled.
_FEW_DECADES = 50.0

# Shares up to here are drawn on an axis of this length.
_SMALL_SHARE = 0.05


def experiment_figure(
    results: Mapping[str, np.ndarray], trackers: Sequence[str], metrics: Mapping[str, Metric], title: str, path: Path | None
) -> Figure:
    """Return the figure of an experiment; it is saved at `path` where one is given."""
    names = [name for start in _SHOWN for name in metrics if name.startswith(start)]
    columns = 3
    rows = -(-len(names) // columns)
    with page(path, rows, columns, (10.0, 2.9 * rows + 0.7)) as axes:
        for axis, name in zip(axes.flat, names, strict=False):
            draw_distribution(axis, results, trackers, name, metrics[name])
        for axis in axes.flat[len(names) :]:
            axis.set_visible(False)
        figure = axes.flat[0].figure
        figure.suptitle(title, fontsize=11)
        bottom_legend(axes.flat[0])
    return figure


def draw_distribution(axis, results: Mapping[str, np.ndarray], trackers: Sequence[str], name: str, metric: Metric) -> None:
    """Draw the share of machines (cumulative) at which each tracker's figure is at most so large; failures never arrive."""
    largest, smallest = 0.0, np.inf
    for i, tracker in enumerate(trackers):
        all_values = results[name][results["tracker"] == tracker].astype(float)
        values = np.sort(all_values[np.isfinite(all_values)])
        if len(values):
            largest = max(largest, float(values[-1]))
            smallest = min(smallest, float(values[int(0.05 * len(values))]))
        share = 100 * np.arange(len(values) + 1) / max(1, len(all_values))
        colour = TRACKER_COLOURS.get(tracker, SERIES[(i + 3) % len(SERIES)])
        # Trackers that hardly differ lie on one another: what is drawn later is dashed, and the one below shows between.
        axis.step(
            np.append(values[:1], values),
            share if len(values) else [],
            where="post",
            color=colour,
            label=tracker,
            linestyle=_DASHED.get(tracker, "-"),
        )
    unit = "" if metric.unit == "1" else f" [{metric.unit}]"
    axis.set_xlabel(f"{metric.text}{unit}")
    axis.set_ylabel("machines up to there [%]")
    axis.set_ylim(0, 102)
    if metric.unit == "1" and largest < _SMALL_SHARE:
        axis.set_xlim(-0.02 * _SMALL_SHARE, _SMALL_SHARE)  # where all are zero a range about it would go below
    if smallest > 0 and largest > 20 * smallest:
        axis.set_xscale("log")
        axis.xaxis.set_minor_formatter(NullFormatter())  # over less than two decades their labels run into one another
        if largest < _FEW_DECADES * smallest:  # of which as a rule one power of ten, or none, would be all that is labelled
            axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    else:
        axis.locator_params(axis="x", nbins=5)
