"""Means and shares with 95 % confidence intervals.

A mean's is Student's; a share's is Wilson's (Journal of the American Statistical Association 22, 1927), which holds near 0
and 1 too. Both take samples for independent: a Latin hypercube's mean varies less than that, so that its interval is
a wide one.
"""

from dataclasses import dataclass

import numpy as np

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A value, the interval that covers the truth with the stated confidence, and the number of samples."""

    value: float
    low: float
    high: float
    n: int

    @property
    def half(self) -> float:
        """Half of the interval's width."""
        return 0.5 * (self.high - self.low)


_NOTHING = Estimate(value=float("nan"), low=float("nan"), high=float("nan"), n=0)


@np.errstate(over="ignore", invalid="ignore")  # efforts of feedback loops that diverge: the interval is then infinite
def mean_of(values: np.ndarray, confidence: float = CONFIDENCE) -> Estimate:
    """Return the mean of the values (n,) that are numbers."""
    from scipy.stats import t

    kept = values[np.isfinite(values)]
    if not len(kept):
        return _NOTHING
    mean = float(np.mean(kept))
    if len(kept) == 1:
        return Estimate(value=mean, low=-np.inf, high=np.inf, n=1)
    half = float(t.ppf(0.5 + confidence / 2, len(kept) - 1) * np.std(kept, ddof=1) / np.sqrt(len(kept)))
    return Estimate(value=mean, low=mean - half, high=mean + half, n=len(kept))


def share_of(hits: int, n: int, confidence: float = CONFIDENCE) -> Estimate:
    """Return the share of hits among n."""
    from scipy.stats import norm

    if n == 0:
        return _NOTHING
    z, p = float(norm.ppf(0.5 + confidence / 2)), hits / n
    middle, half = (
        (p + z * z / (2 * n)) / (1 + z * z / n),
        z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n),
    )
    return Estimate(value=p, low=float(middle - half) if hits else 0.0, high=float(middle + half) if hits < n else 1.0, n=n)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Two trackers on the same samples: the mean of first minus second, and how often the first is the better one.

    A sample that one of them did not finish is lost by that one; one that neither finished, or a tie, counts for neither.
    """

    first: str
    second: str
    metric: str
    difference: Estimate
    wins: Estimate


def pair_of(first: str, second: str, metric: str, a: np.ndarray, b: np.ndarray) -> Pair:
    """Return the comparison of two trackers' values (n,) of a metric of which less is better, sample by sample."""
    x, y = (np.where(np.isfinite(values), values, np.inf) for values in (a, b))
    decided = x != y
    return Pair(
        first=first,
        second=second,
        metric=metric,
        difference=mean_of(np.where(np.isfinite(a) & np.isfinite(b), a, np.nan) - b),
        wins=share_of(int(np.sum(x[decided] < y[decided])), int(np.sum(decided))),
    )
