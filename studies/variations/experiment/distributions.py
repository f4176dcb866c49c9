"""The distributions of an experiment's metrics over the machines, as plots and as a figure."""

from collections.abc import Mapping, Sequence

import numpy as np

from linkplan.studies.output.document import Axis, Plot, Series
from linkplan.studies.output.lines import overlaid_width, tracker_colour
from linkplan.studies.output.numbers import rounded
from linkplan.studies.variations.experiment.metrics import Metric

# The first words of the metrics in the figure, in this order; on a page the distributions of the others are collapsed.
SHOWN = ("rms_error", "max_error", "final_error", "peak_effort", "chatter", "saturated_share")


def distributions(
    results: Mapping[str, np.ndarray], trackers: Sequence[str], names: Sequence[str], metrics: Mapping[str, Metric]
) -> list[Plot]:
    """Return the distributions of metrics, without metrics that have the same value on all machines."""
    found = [_distribution(results, trackers, name, metrics[name]) for name in names]
    return [plot for plot in found if plot is not None]


def _distribution(results: Mapping[str, np.ndarray], trackers: Sequence[str], name: str, metric: Metric) -> Plot | None:
    """Return the cumulative distribution of a metric for every tracker; None if all values are equal.

    Failures keep it below 100 %. The axis is logarithmic if the largest value is more than 20 times the fifth percentile.
    """
    columns = {tracker: results[name][results["tracker"] == tracker].astype(float) for tracker in trackers}
    known = {tracker: np.sort(values[np.isfinite(values)]) for tracker, values in columns.items()}
    some = [values for values in known.values() if len(values)]
    if not some or np.ptp(np.concatenate(some)) == 0:
        return None
    low, high = min(float(values[int(0.05 * len(values))]) for values in some), max(float(values[-1]) for values in some)
    log = low > 0 and high > 20 * low
    series = []
    for k, (tracker, values) in enumerate(known.items()):
        if not len(values):
            continue
        rows = np.unique(np.linspace(0, len(values) - 1, num=101).astype(int))
        share = 100 * (rows + 1) / len(columns[tracker])
        x = values[rows]
        shown = (x > 0) | (not log)
        last = np.append(np.diff(x) > 0, x[-1] < high) & shown  # equal values: the largest share
        series.append(
            Series(
                name=tracker,
                x=rounded(np.concatenate([x[shown][:1], x[last], [high]]), log=log),
                y=rounded(np.concatenate([[0.0], share[last], share[-1:]])),
                look="steps",
                colour=tracker_colour(tracker, k + 3),
                width=overlaid_width(k, len(known)),
            )
        )
    ends = [x for one in series for x in (one.x[0], one.x[-1])]
    return Plot(
        title=f"{metric.text[:1].upper()}{metric.text[1:]}",
        group="",
        x_axis=Axis(label=metric.text, unit=metric.unit, log=log),
        y_axis=Axis(label="machines", unit="%", ends=(0.0, 102.0)),
        x=[min(ends), max(ends)],
        series=series,
    )
