"""The figure of the imperfections' influences: a tornado chart for each tracker, in a common order of imperfections."""

import math
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from linkplan.studies.experiment.sensitivity import Sensitivity, Varied
from linkplan.studies.experiment.sensitivity_text import shown
from linkplan.studies.output.drawing import BLACK, BLUE, GREY, ORANGE, SKY, bottom_legend, page
from linkplan.studies.sensitivity.scheme import MORRIS, ONE_AT_A_TIME, SOBOL

# Height of a bar, where imperfections are one unit apart.
_BAR_HEIGHT = 0.36


def save_tornados(sensitivity: Sensitivity, name: str, folder: Path) -> None:
    """Save the figure of each rms error in a folder: sensitivity.png, and a second one for hinges and slides together."""
    for i, metric in enumerate(sensitivity.mains):
        title = tornado_title(sensitivity, name, metric)
        tornado_figure(sensitivity, metric, title, folder / ("sensitivity.png" if i == 0 else f"sensitivity_{metric}.png"))


def tornado_title(sensitivity: Sensitivity, name: str, metric: str) -> str:
    """Return the title of a figure: plan, metric, design and number of machines."""
    machines = sensitivity.groups * sensitivity.size
    text = sensitivity.metrics[metric].text
    return f"{name}: what the {text} owes to each imperfection ({sensitivity.design}, {machines} machines)"


def tornado_figure(sensitivity: Sensitivity, metric: str, title: str, path: Path | None) -> Figure:
    """Return the figure of the imperfections' influences on a metric, saved at `path` if given."""
    trackers, order = tuple(sensitivity.influences), shown(sensitivity)
    columns = min(3, len(trackers))
    rows = -(-len(trackers) // columns)
    size = (2.6 + 3.1 * columns, 1.3 + rows * (1.0 + 0.36 * len(order)))
    share = {"sharey": True, "sharex": sensitivity.design == SOBOL}
    with page(path, rows, columns, size, **share) as axes:
        for axis, tracker in zip(axes.flat, trackers, strict=False):
            draw_tornado(axis, sensitivity, tracker, metric, order)
            axis.set_title(tracker)
        for axis in axes.flat[len(trackers) :]:
            axis.set_visible(False)
        first = axes.flat[0]
        first.set_yticks(range(len(order)), [_named(sensitivity.factors[i], sensitivity.design) for i in order])
        first.set_ylim(len(order) - 0.4, -0.6)
        if sensitivity.design == SOBOL:
            first.set_xlim(left=0.0)
        first.figure.suptitle(title, fontsize=11)
        bottom_legend(first)
    return first.figure


def draw_tornado(axis, sensitivity: Sensitivity, tracker: str, metric: str, order: list[int]) -> None:
    """Draw bars for each imperfection, in the given order from the top."""
    draw = {ONE_AT_A_TIME: _draw_ends, MORRIS: _draw_effects, SOBOL: _draw_shares}[sensitivity.design]
    draw(axis, sensitivity, tracker, metric, order)
    axis.xaxis.set_major_locator(MaxNLocator(4))
    axis.grid(visible=False, axis="y")
    axis.tick_params(axis="y", length=0)


def _draw_ends(axis, sensitivity: Sensitivity, tracker: str, metric: str, order: list[int]) -> None:
    one, place = sensitivity.influences[tracker][metric], np.arange(len(order))
    ends = [("at_low", "at the low end", BLUE, -1), ("at_high", "at the high end", ORANGE, 1)]
    for name, label, colour, side in ends:
        reached = one.parts[name][order]
        width = np.nan_to_num(reached - one.middle)
        axis.barh(place + side * _BAR_HEIGHT / 2, width, _BAR_HEIGHT, left=one.middle, color=colour, label=label)
        for k in np.flatnonzero(~np.isfinite(reached)):
            axis.annotate(
                f" lost {label}", (one.middle, place[k] + side * _BAR_HEIGHT / 2), va="center", fontsize=7, color=BLACK
            )
    axis.axvline(one.middle, color=BLACK, linewidth=0.9, label="all in the middle")
    axis.set_xlabel(_what(sensitivity, metric))


def _draw_effects(axis, sensitivity: Sensitivity, tracker: str, metric: str, order: list[int]) -> None:
    one, place = sensitivity.influences[tracker][metric], np.arange(len(order))
    size, mean, half = (x[order] for x in (one.importance, one.parts["mean"], one.high - one.importance))
    # The mean increase and the mean decrease of the figure. Their sum is the mean absolute effect, shown in the margin.
    axis.barh(place, (size + mean) / 2, 2 * _BAR_HEIGHT, color=ORANGE, label="raised towards the high end")
    axis.barh(place, -(size - mean) / 2, 2 * _BAR_HEIGHT, color=BLUE, label="lowered")
    digits = max(0, 1 - math.floor(math.log10(np.nanmax(size)))) if np.any(size > 0) else 0
    for k in np.flatnonzero(np.isfinite(size)):
        text = f"{size[k]:.{digits}f} ± {half[k]:.{digits}f}"
        axis.annotate(text, (1.01, place[k]), xycoords=axis.get_yaxis_transform(), va="center", fontsize=7.5)
    axis.plot([], [], " ", label="beside: the mean size, 95 % interval")
    axis.axvline(0.0, color=BLACK, linewidth=0.9)
    axis.set_xlabel(f"mean change of the {_what(sensitivity, metric)}")


def _draw_shares(axis, sensitivity: Sensitivity, tracker: str, metric: str, order: list[int]) -> None:
    one, place = sensitivity.influences[tracker][metric], np.arange(len(order))
    total, half = 100 * one.importance[order], 100 * (one.high - one.importance)[order]
    first, first_half = (100 * one.parts[name][order] for name in ("first_order", "first_order_half"))
    bars = [
        (total, half, "by itself or with others (total index)", SKY, -1),
        (np.maximum(first, 0), first_half, "by itself (first-order index)", BLUE, 1),
    ]
    for width, error, label, colour, side in bars:
        axis.barh(place + side * _BAR_HEIGHT / 2, width, _BAR_HEIGHT, color=colour, label=label)
        if np.any(np.isfinite(width)):
            axis.errorbar(
                width, place + side * _BAR_HEIGHT / 2, xerr=error, fmt="none", ecolor=GREY, elinewidth=0.9, capsize=1.5,
                label="95 % interval" if side > 0 else None,
            )  # fmt: skip
    axis.set_xlabel("share of the variance [%]")


def _what(sensitivity: Sensitivity, metric: str) -> str:
    one = sensitivity.metrics[metric]
    return one.text if one.unit == "1" else f"{one.text} [{one.unit}]"


def _named(factor: Varied, design: str) -> str:
    if factor.ends is None:
        return factor.label + {ONE_AT_A_TIME: "\n95 of 100 draws", MORRIS: "\none to another"}.get(design, "")
    unit = "" if factor.unit == "1" else f" {factor.unit}"
    low, high = (_short(end, factor.ends) for end in factor.ends)
    return f"{factor.label}\n{low} to {high}{unit}"


def _short(value: float, ends: tuple[float, float]) -> str:
    """Return a number with enough digits to distinguish the ends."""
    width = abs(ends[1] - ends[0])
    digits = max(0, 1 - math.floor(math.log10(width))) if width > 0 else 3
    return f"{value:.{min(digits, 6)}f}" if max(map(abs, ends)) < 1e5 else f"{value:.3g}"
