"""The influence of each factor on a figure, from its values at a scheme's trials.

* One at a time: the change of the figure between the ends of a factor's range, with the other factors in the middle.
* Morris: the mean absolute elementary effect, which is the change across the whole range, from many base points.
* Sobol: the total index, which is the share of the figure's variance that involves the factor, alone or with others.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from linkplan.studies.variations.sensitivity.scheme import (
    MORRIS,
    MORRIS_LEVELS,
    ONE_AT_A_TIME,
    SOBOL,
    SamplingScheme,
    salib,
    unit_cube,
)

_CONFIDENCE_LEVEL = 0.95
_BOOTSTRAP_RESAMPLES = 100
# Half width of a normal distribution's central 95 % interval, in standard deviations.
NORMAL_QUANTILE = 1.959963984540054
# Figures with a smaller relative range are equal up to rounding.
_ROUNDING_SHARE = 1e-12


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Influence:
    """The importance of each factor (d,) for a figure, with a 95 % interval, and additional values.

    `parts` are arrays (d,) that depend on the design. One at a time: the figure "at_low" and "at_high". Morris: the "mean"
    of the signed elementary effects and their standard deviation "spread". Sobol: the "first_order" index and the half
    width of its interval. `middle` is the figure in the middle of all ranges, or the mean of the independent trials.
    `left_out` is the number of the `groups` groups without a figure. An importance is infinite if a trial at an end of the
    range has no figure, and NaN if there are too few groups.
    """

    importance: np.ndarray
    low: np.ndarray
    high: np.ndarray
    parts: Mapping[str, np.ndarray]
    middle: float
    groups: int
    left_out: int

    @property
    def order(self) -> np.ndarray:
        """The factors (d,) in decreasing order of importance; equal and unknown ones keep their order."""
        return np.argsort(np.where(np.isnan(self.importance), np.inf, -self.importance), kind="stable")


def influence_of(scheme: SamplingScheme, figures: np.ndarray, seed: int = 0) -> Influence:
    """Return the influences of the factors on a figure.

    Args:
        scheme: the scheme of the trials.
        figures: (n,), one for each trial; NaN for a trial without a figure.
        seed: of the bootstrap.
    """
    table = np.asarray(figures, dtype=float).reshape(scheme.n_groups, scheme.size)
    known = np.isfinite(table)
    kept = known[:, 0] if scheme.design == ONE_AT_A_TIME else np.all(known, axis=1)
    whole, nothing = table[kept], np.full(scheme.n_factors, np.nan)
    count = {"groups": len(table), "left_out": int(np.sum(~kept))}
    if len(whole) < (1 if scheme.design == ONE_AT_A_TIME else 2):
        parts = dict.fromkeys(_PARTS[scheme.design], nothing)
        return Influence(importance=nothing, low=nothing, high=nothing, parts=parts, middle=float("nan"), **count)
    independent = whole[:, scheme.independent[: scheme.size]]
    compute = {ONE_AT_A_TIME: _one_at_a_time, MORRIS: _morris, SOBOL: _sobol}[scheme.design]
    importance, low, high, parts = compute(scheme, whole, kept, seed)
    middle = float(np.mean(independent))
    return Influence(importance=importance, low=low, high=high, parts=parts, middle=middle, **count)


_PARTS = {
    ONE_AT_A_TIME: ("at_low", "at_high"),
    MORRIS: ("mean", "spread"),
    SOBOL: ("first_order", "first_order_half"),
}
_Found = tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, np.ndarray]]


def _one_at_a_time(scheme: SamplingScheme, whole: np.ndarray, kept: np.ndarray, seed: int) -> _Found:
    """Return the range of the result over a factor's ends and middle: its mean over noise draws, with Student's interval."""
    from scipy.stats import t

    del kept, seed
    n, middle, low, high = len(whole), whole[:, :1], whole[:, 1::2], whole[:, 2::2]
    change = np.maximum(np.maximum(low, high), middle) - np.minimum(np.minimum(low, high), middle)
    change = np.where(np.isfinite(low) & np.isfinite(high), change, np.inf)  # no figure at an end
    importance = np.mean(change, axis=0)
    with np.errstate(invalid="ignore"):
        spread = np.std(change, axis=0, ddof=1) if n > 1 else np.zeros_like(importance)
        half = t.ppf(0.5 + _CONFIDENCE_LEVEL / 2, max(n - 1, 1)) * spread / np.sqrt(n)
    half = np.where(np.isfinite(importance), half, 0.0)
    ends = [np.mean(low, axis=0), np.mean(high, axis=0)]
    if scheme.noisy:  # the range of the noise is the central 95 % interval of its draws
        mean, size = float(np.mean(middle)), NORMAL_QUANTILE * float(np.std(middle, ddof=1)) if n > 1 else float("nan")
        importance, half = np.append(importance, 2 * size), np.append(half, np.nan)
        ends = [np.append(ends[0], mean - size), np.append(ends[1], mean + size)]
    return importance, importance - half, importance + half, dict(zip(_PARTS[ONE_AT_A_TIME], ends, strict=True))


def _morris(scheme: SamplingScheme, whole: np.ndarray, kept: np.ndarray, seed: int) -> _Found:
    points = scheme.points
    if scheme.noisy:  # the column of the noise marks the steps in which the draw changes
        changed = scheme.draws.reshape(scheme.n_groups, scheme.size)
        points = np.column_stack([points, (changed != changed[:, :1]).ravel().astype(float)])
    rows = np.repeat(kept, scheme.size)
    found = salib("analyze.morris").analyze(
        unit_cube(scheme.n_factors),
        points[rows],
        whole.ravel(),
        num_resamples=_BOOTSTRAP_RESAMPLES,
        conf_level=_CONFIDENCE_LEVEL,
        num_levels=MORRIS_LEVELS,
        seed=np.random.default_rng(seed),
    )
    names = ("mu_star", "mu_star_conf", "mu", "sigma")
    importance, half, mean, spread = (np.array(found[name], dtype=float) for name in names)
    if scheme.noisy:  # the effect of another draw has no sign and is not scaled to a range
        step = MORRIS_LEVELS / (2.0 * (MORRIS_LEVELS - 1))
        for array in (importance, half, spread):
            array[-1] *= step
        mean[-1] = 0.0
    return importance, importance - half, importance + half, {"mean": mean, "spread": spread}


def _sobol(scheme: SamplingScheme, whole: np.ndarray, kept: np.ndarray, seed: int) -> _Found:
    del kept
    d = scheme.n_factors
    if np.ptp(whole) <= _ROUNDING_SHARE * np.abs(whole).max():  # no variance
        zero = np.zeros(d)
        return zero, zero, zero, {"first_order": zero, "first_order_half": zero}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # resamples of rare events, such as failures, may be constant
        found = salib("analyze.sobol").analyze(
            unit_cube(d),
            whole.ravel(),
            calc_second_order=False,
            num_resamples=_BOOTSTRAP_RESAMPLES,
            conf_level=_CONFIDENCE_LEVEL,
            seed=seed + 1,  # SALib treats 0 as no seed
        )
    total, half = np.asarray(found["ST"]), np.asarray(found["ST_conf"])
    parts = {"first_order": np.asarray(found["S1"]), "first_order_half": np.asarray(found["S1_conf"])}
    return total, total - half, total + half, parts
