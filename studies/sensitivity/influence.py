"""What a figure owes to each factor, from its values at a scheme's trials.

One at a time it is the change between the ends of a factor's range, the others in the middle. Morris' is the mean size of
the elementary effects: the change across the whole range, seen from many places. Sobol's is the total index: the share of
the figure's variance that the factor has a part in, by itself or together with others.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from linkplan.studies.sensitivity.salib import salib, unit_cube
from linkplan.studies.sensitivity.scheme import LEVELS, MORRIS, ONE_AT_A_TIME, SOBOL, Scheme

CONFIDENCE = 0.95
_RESAMPLES = 100
# Normal values lie so many standard deviations about their mean 95 times of 100.
ENDS = 1.959963984540054
# Fewer groups than these say nothing.
_LEAST = 2
# Figures of which all are so near to one another, in parts of the largest, are one and the same but for rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Influence:
    """What a figure owes to each factor (d,): its importance with a 95 % interval, and the parts that it is made of.

    `parts` by design, arrays (d,): one at a time the figure "at_low" and "at_high"; Morris' "mean" of the elementary effects
    with their signs and their standard deviation "spread"; Sobol's "first_order" index, with the half width of its interval.
    `middle` is the figure in the middle of all ranges, or the mean of the independent trials. Of `groups` groups `left_out`
    had no figure. An importance is infinite where the figure is lost at an end, NaN where nothing can be said.
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
        """The factors (d,) from the most important on; equal ones, and those of which nothing is known, as they come."""
        return np.argsort(np.where(np.isnan(self.importance), np.inf, -self.importance), kind="stable")


def influence_of(scheme: Scheme, figures: np.ndarray, seed: int = 0) -> Influence:
    """Return what figures (n,), one for each trial, owe to the factors; a NaN is a trial without one.

    Args:
        scheme: of the trials.
        figures: of the trials, in its order.
        seed: of the bootstrap's resampling.
    """
    table = np.asarray(figures, dtype=float).reshape(scheme.n_groups, scheme.size)
    kept = np.isfinite(table[:, 0]) if scheme.design == ONE_AT_A_TIME else np.isfinite(table).all(axis=1)
    whole, nothing = table[kept], np.full(scheme.n_factors, np.nan)
    count = {"groups": len(table), "left_out": int(np.sum(~kept))}
    if len(whole) < (1 if scheme.design == ONE_AT_A_TIME else _LEAST):
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


def _one_at_a_time(scheme: Scheme, whole: np.ndarray, kept: np.ndarray, seed: int) -> _Found:
    """Return changes between the ends, the middle counted too, as means over the noise's draws with Student's interval."""
    from scipy.stats import t

    del kept, seed
    n, middle, low, high = len(whole), whole[:, :1], whole[:, 1::2], whole[:, 2::2]
    change = np.maximum(np.maximum(low, high), middle) - np.minimum(np.minimum(low, high), middle)
    change = np.where(np.isfinite(low) & np.isfinite(high), change, np.inf)  # the figure is lost at an end
    importance = np.mean(change, axis=0)
    with np.errstate(invalid="ignore"):
        spread = np.std(change, axis=0, ddof=1) if n > 1 else np.zeros_like(importance)
        half = t.ppf(0.5 + CONFIDENCE / 2, max(n - 1, 1)) * spread / np.sqrt(n)
    half = np.where(np.isfinite(importance), half, 0.0)
    ends = [np.mean(low, axis=0), np.mean(high, axis=0)]
    if scheme.noisy:  # the ends of luck: those of 95 draws of 100
        mean, size = float(np.mean(middle)), ENDS * float(np.std(middle, ddof=1)) if n > 1 else float("nan")
        importance, half = np.append(importance, 2 * size), np.append(half, np.nan)
        ends = [np.append(ends[0], mean - size), np.append(ends[1], mean + size)]
    return importance, importance - half, importance + half, dict(zip(_PARTS[ONE_AT_A_TIME], ends, strict=True))


def _morris(scheme: Scheme, whole: np.ndarray, kept: np.ndarray, seed: int) -> _Found:
    points = scheme.points
    if scheme.noisy:  # its column anew: all that counts is where the draw changes
        changed = scheme.draws.reshape(scheme.n_groups, scheme.size)
        points = np.column_stack([points, (changed != changed[:, :1]).ravel().astype(float)])
    rows = np.repeat(kept, scheme.size)
    found = salib("analyze.morris").analyze(
        unit_cube(scheme.n_factors),
        points[rows],
        whole.ravel(),
        num_resamples=_RESAMPLES,
        conf_level=CONFIDENCE,
        num_levels=LEVELS,
        seed=np.random.default_rng(np.random.SeedSequence(seed)),
    )
    names = ("mu_star", "mu_star_conf", "mu", "sigma")
    importance, half, mean, spread = (np.array(found[name], dtype=float) for name in names)
    if scheme.noisy:  # not across a range, but from one draw to another, and to neither side
        step = LEVELS / (2.0 * (LEVELS - 1))
        for array in (importance, half, spread):
            array[-1] *= step
        mean[-1] = 0.0
    return importance, importance - half, importance + half, {"mean": mean, "spread": spread}


def _sobol(scheme: Scheme, whole: np.ndarray, kept: np.ndarray, seed: int) -> _Found:
    del kept
    d = scheme.n_factors
    if np.ptp(whole) <= _ROUNDING * np.abs(whole).max():  # no variance to have shares of
        zero = np.zeros(d)
        return zero, zero, zero, {"first_order": zero, "first_order_half": zero}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of resamples that happen to be constant: rare events, such as failures
        found = salib("analyze.sobol").analyze(
            unit_cube(d),
            whole.ravel(),
            calc_second_order=False,
            num_resamples=_RESAMPLES,
            conf_level=CONFIDENCE,
            seed=seed + 1,  # 0 would be no seed to it
        )
    total, half = np.asarray(found["ST"]), np.asarray(found["ST_conf"])
    parts = {"first_order": np.asarray(found["S1"]), "first_order_half": np.asarray(found["S1_conf"])}
    return total, total - half, total + half, parts
