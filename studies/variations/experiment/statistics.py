"""The summary of an experiment: means and shares with 95 % confidence intervals, pairs of trackers, the worst samples.

Means have Student's interval. The mean of a Latin hypercube varies less than that of independent samples, so an experiment
has several independent hypercubes, and the interval follows from their means. Shares have Wilson's interval (Journal of the
American Statistical Association 22, 1927), which is also valid near 0 and 1. It assumes independent samples, and is
conservative for a hypercube.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct, field

from linkplan.planner.files.structs import Number
from linkplan.studies.variations.experiment.experiment import Experiment
from linkplan.studies.variations.experiment.metrics import Metric


class Estimate(Struct, frozen=True, kw_only=True):
    """A value, its confidence interval, and the number of samples."""

    value: Number
    interval95: tuple[Number, Number]
    n: int

    @property
    def low(self) -> float:
        """The lower end of the interval."""
        return self.interval95[0]

    @property
    def high(self) -> float:
        """The upper end of the interval."""
        return self.interval95[1]

    @property
    def half(self) -> float:
        """Half of the interval's width."""
        return 0.5 * (self.high - self.low)


_NO_ESTIMATE = Estimate(value=np.nan, interval95=(np.nan, np.nan), n=0)


@np.errstate(over="ignore", invalid="ignore")  # the huge efforts of diverging loops overflow, and the interval is infinite
def mean_of(values: np.ndarray, replicate: np.ndarray | None = None) -> Estimate:
    """Return the mean of the finite values among (n,).

    `replicate` (n,) is the number of the independent group that each value belongs to; by default each is its own.
    """
    from scipy.stats import t

    finite = np.isfinite(values)
    kept = values[finite]
    if not len(kept):
        return _NO_ESTIMATE
    _, group = np.unique(np.arange(len(kept)) if replicate is None else replicate[finite], return_inverse=True)
    share = np.bincount(group) / len(kept)
    means = np.bincount(group, kept) / np.bincount(group)
    mean, groups = float(np.mean(kept)), len(means)
    if groups == 1:
        return Estimate(value=mean, interval95=(-np.inf, np.inf), n=len(kept))
    error = np.sqrt(groups / (groups - 1) * np.sum((share * (means - mean)) ** 2))
    half = float(t.ppf(0.975, groups - 1) * error)
    return Estimate(value=mean, interval95=(mean - half, mean + half), n=len(kept))


def share_of(hits: int, n: int) -> Estimate:
    """Return the share of hits among n."""
    from scipy.stats import binomtest

    if n == 0:
        return _NO_ESTIMATE
    ends = binomtest(hits, n).proportion_ci(method="wilson")
    return Estimate(value=hits / n, interval95=(float(ends.low), float(ends.high)), n=n)


class Pair(Struct, frozen=True, kw_only=True):
    """Two trackers on the same samples: the mean of first minus second, and the share of samples won by the first.

    A tracker that failed on a sample loses it. Ties and samples on which both failed count for neither.
    """

    first: str
    second: str
    metric: str
    difference: Estimate
    wins: Estimate = field(name="wins_of_first")


def pair_of(first: str, second: str, metric: str, a: np.ndarray, b: np.ndarray, replicate: np.ndarray | None = None) -> Pair:
    """Return the samplewise comparison of two trackers' values (n,) of a metric; smaller values are better."""
    x, y = (np.where(np.isfinite(values), values, np.inf) for values in (a, b))
    decided = x != y
    return Pair(
        first=first,
        second=second,
        metric=metric,
        difference=mean_of(np.where(np.isfinite(a) & np.isfinite(b), a, np.nan) - b, replicate),
        wins=share_of(int(np.sum(x[decided] < y[decided])), int(np.sum(decided))),
    )


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
