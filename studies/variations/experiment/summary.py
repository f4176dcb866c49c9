"""The summary of an experiment: each tracker's metrics with intervals, pairs of trackers, the worst samples."""

from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct, field

from linkplan.planner.files.structs import Number
from linkplan.studies.variations.experiment.experiment import Experiment
from linkplan.studies.variations.experiment.metrics import Metric
from linkplan.studies.variations.experiment.statistics import Estimate, Pair, mean_of, pair_of, share_of

# A tracker chatters if its effort's total variation exceeds this multiple of the plan's variation plus the limits' range.
CHATTER_FACTOR = 5.0


class TrackerSummary(Struct, frozen=True, kw_only=True, eq=False):
    """One tracker over all samples: means by metric, 95th percentiles, success, failures by reason, worst samples.

    The worst samples are failed samples first, then those with the largest error.
    """

    means: dict[str, Estimate] = field(name="mean")
    percentile95: dict[str, Number]
    success: Estimate
    failures: dict[str, int]
    worst: tuple[int, ...] = field(name="worst_samples")


class Summary(Struct, frozen=True, kw_only=True, eq=False):
    """The results of each tracker, and of each pair of trackers, compared by the first rms error in `metrics`."""

    samples: int
    trackers: dict[str, TrackerSummary]
    pairs: tuple[Pair, ...]
    metrics: dict[str, Metric]


def summarise(
    results: Mapping[str, np.ndarray],
    trackers: Sequence[str],
    metrics: Mapping[str, Metric],
    replicate: np.ndarray | None = None,
) -> Summary:
    """Return the summary of a results table's columns.

    `replicate` (n,) is the number of the Latin hypercube that each sample belongs to; None for independent samples.
    """
    rows = {name: results["tracker"] == name for name in trackers}
    main = next(name for name in metrics if name.startswith("rms_error"))
    largest = next(name for name in metrics if name.startswith("max_error"))
    found = {}
    for name in trackers:
        at = rows[name]
        group = None if replicate is None else replicate[results["sample"][at]]
        failure = results["failure"][at]
        failed = np.array([text is not None for text in failure])
        values = {metric: results[metric][at].astype(float) for metric in metrics}
        order = np.argsort(-np.where(failed, np.inf, values[largest]), kind="stable")
        texts = [str(text) for text in failure[failed]]
        found[name] = TrackerSummary(
            means={metric: mean_of(values[metric], group) for metric in metrics},
            percentile95={metric: _percentile(values[metric]) for metric in metrics},
            success=share_of(int(np.sum(results["success"][at])), int(np.sum(at))),
            failures={text: texts.count(text) for text in sorted(set(texts))},
            worst=tuple(int(sample) for sample in results["sample"][at][order[:3]]),
        )
    pairs = [
        pair_of(a, b, main, results[main][rows[a]].astype(float), results[main][rows[b]].astype(float), group)
        for i, a in enumerate(trackers)
        for b in trackers[i + 1 :]
    ]
    samples = int(np.sum(rows[trackers[0]]))
    return Summary(samples=samples, trackers=found, pairs=tuple(pairs), metrics=dict(metrics))


def chatter_notes(experiment: Experiment, summary: Summary) -> list[str]:
    """Return a sentence on each tracker whose effort has a much larger total variation than the plan's."""
    reference, limit = experiment.reference, experiment.loop.effort_limit
    planned = float(np.abs(np.diff(reference.effort, axis=0)).sum())
    span = float(np.sum(np.where(np.isfinite(limit), np.abs(limit), 0.0)))
    unit = summary.metrics["chatter"].unit
    return [
        f"{name} chatters: the total variation of its effort is {varied:.3g} {unit}, that of the plan {planned:.3g}; its"
        " gains are too high for this period, delay and encoder"
        for name, one in summary.trackers.items()
        if (varied := one.means["chatter"].value) > CHATTER_FACTOR * planned + span
    ]


def _percentile(values: np.ndarray) -> float:
    kept = values[np.isfinite(values)]
    return float(np.percentile(kept, 95)) if len(kept) else float("nan")
