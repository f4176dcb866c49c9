"""The machines of an experiment: their random factors' values, by a design."""

import itertools
from collections.abc import Sequence

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.planner.problem.imperfections import Factor, Spread

LATIN_HYPERCUBE = "latin-hypercube"
DESIGNS = (LATIN_HYPERCUBE, "grid")
# Half width of a normal distribution's central 95 % interval, in standard deviations.
_NORMAL_QUANTILE = 1.959963984540054
# Independent Latin hypercubes of an experiment: their means give the confidence intervals.
N_HYPERCUBES = 10
# Most samples of an experiment: more are probably a typing error.
MOST_SAMPLES = 1_000_000


def machines_by_design(factors: Sequence[Factor], design: str, samples: int, levels: int, seed: int) -> np.ndarray:
    """Return the factors' values (n, d) in a problem file's units.

    Fixed factors are the same in every sample. In a Latin hypercube, each factor's range is divided into intervals of equal
    probability, and each interval has one sample (McKay, Beckman and Conover, Technometrics 21, 1979). The samples are
    `N_HYPERCUBES` independent hypercubes, whose means give the uncertainty of the overall mean (Iman & Conover,
    Communications in Statistics A 9, 1980). A grid has `levels` values of each factor, evenly spaced over its range, for a
    normal distribution over its central 95 %.

    Raises:
        ProblemError: for a grid of more than `MOST_SAMPLES`.
    """
    random = varied(factors)
    shares = _grid(len(random), levels) if design == "grid" else _hypercubes(len(random), samples, seed)
    values = np.tile([factor.spread.first for factor in factors], (len(shares), 1)).reshape(len(shares), len(factors))
    for column, i in enumerate(random):
        quantity, share = factors[i].quantity, shares[:, column]
        low, high = ends_of(factors[i])
        value = at_chance(factors[i].spread, share) if design == LATIN_HYPERCUBE else low + share * (high - low)
        values[:, i] = np.clip(value, quantity.low, quantity.high)
    return values


def _grid(count: int, levels: int) -> np.ndarray:
    """Return the shares (n, count) of ranges at the nodes of a grid."""
    size = levels**count
    if size > MOST_SAMPLES:
        raise ProblemError(
            f"a grid of {levels} levels in {count} factors has {size:.3g} samples, at most {MOST_SAMPLES}; a"
            " Latin hypercube takes any number"
        )
    even = np.linspace(0.0, 1.0, levels) if levels > 1 else np.full(1, 0.5)
    return np.array(list(itertools.product(even, repeat=count))).reshape(size, count)


def _hypercubes(count: int, samples: int, seed: int) -> np.ndarray:
    """Return the probabilities (samples, count) of independent Latin hypercubes."""
    from scipy.stats import qmc

    if count == 0:
        return np.zeros((samples, 0))
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    sizes = np.bincount(replicate_of(samples))
    return np.vstack([qmc.LatinHypercube(count, rng=rng).random(int(size)) for size in sizes])


def replicate_of(samples: int) -> np.ndarray:
    """Return the number (n,) of the Latin hypercube that each sample belongs to: `N_HYPERCUBES` in turn, of equal size."""
    count = min(N_HYPERCUBES, samples)
    return np.arange(samples) * count // samples


def varied(factors: Sequence[Factor]) -> list[int]:
    """Return the indices of the factors that differ between machines."""
    return [i for i, factor in enumerate(factors) if factor.spread.random]


def ends_of(factor: Factor) -> tuple[float, float]:
    """Return the ends of a factor's range; for a normal distribution, of its central 95 % interval."""
    spread = factor.spread
    if spread.kind == "normal":
        ends = spread.first - _NORMAL_QUANTILE * spread.second, spread.first + _NORMAL_QUANTILE * spread.second
        return max(ends[0], factor.quantity.low), min(ends[1], factor.quantity.high)
    return spread.first, spread.second


def at_chance(spread: Spread, chance: np.ndarray) -> np.ndarray:
    """Return the quantiles of a distribution at probabilities between 0 and 1."""
    from scipy.stats import norm

    if spread.kind == "uniform":
        return spread.first + chance * (spread.second - spread.first)
    return spread.first + spread.second * norm.ppf(chance)
