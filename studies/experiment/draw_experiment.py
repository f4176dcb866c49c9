"""The figure of an experiment: the distribution of each tracker's metrics over the machines."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from linkplan.studies.experiment.metrics import Metric
from linkplan.studies.output.drawing import SERIES, TRACKER_COLOURS, bottom_legend, page

# These laws often coincide with another law, so they are dashed and the line below stays visible.
_DASHED = {"ct": (0, (4, 4)), "mpc": (0, (4, 4))}
# Prefixes of the metrics shown, in this order.
_SHOWN = ("rms_error", "max_error", "final_error", "peak_effort", "chatter", "saturated_share")
# If all shares are smaller, the axis ends here.
_SMALL_SHARE = 0.05


def experiment_figure(
    results: Mapping[str, np.ndarray], trackers: Sequence[str], metrics: Mapping[str, Metric], title: str, path: Path | None
) -> Figure:
    """Return the figure of an experiment, saved at `path` if given."""
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
    """Draw the cumulative distribution of a metric over the machines for each tracker; failures keep it below 100 %."""
    largest, smallest = 0.0, np.inf
    for i, tracker in enumerate(trackers):
        all_values = results[name][results["tracker"] == tracker].astype(float)
        values = np.sort(all_values[np.isfinite(all_values)])
        if len(values):
            largest = max(largest, float(values[-1]))
            smallest = min(smallest, float(values[int(0.05 * len(values))]))
        share = 100 * np.arange(len(values) + 1) / max(1, len(all_values))
        colour = TRACKER_COLOURS.get(tracker, SERIES[(i + 3) % len(SERIES)])

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
        axis.set_xlim(-0.02 * _SMALL_SHARE, _SMALL_SHARE)  # also if all values are zero
    if smallest > 0 and largest > 20 * smallest:
        axis.set_xscale("log")
        axis.xaxis.set_minor_formatter(NullFormatter())  # minor labels would overlap
        if largest < 50 * smallest:  # over few decades, label 1, 2 and 5 of each
            axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    else:
        axis.locator_params(axis="x", nbins=5)
