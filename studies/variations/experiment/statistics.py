"""Means and shares with 95 % confidence intervals.

Means have Student's interval. The mean of a Latin hypercube varies less than that of independent samples, so an experiment
has several independent hypercubes, and the interval follows from their means. Shares have Wilson's interval (Journal of the
American Statistical Association 22, 1927), which is also valid near 0 and 1. It assumes independent samples, and is
conservative for a hypercube.
"""

import numpy as np
from msgspec import Struct, field

from linkplan.planner.files.structs import Number


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
