"""The samples of an experiment: a Latin hypercube or a grid over its random factors."""

import itertools
from collections.abc import Sequence

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.planner.problem.imperfections import Factor, Spread
from linkplan.studies.sensitivity.scheme import SENSITIVE

# The first two designs compare trackers over the machines. The others measure the influence of each imperfection.
LATIN_HYPERCUBE = "latin-hypercube"
DESIGNS = (LATIN_HYPERCUBE, "grid", *SENSITIVE)
# Independent Latin hypercubes of an experiment: their means give the confidence intervals.
N_HYPERCUBES = 10
# Most samples of an experiment: more are probably a typing error.
MOST_SAMPLES = 1_000_000


def values_of(factors: Sequence[Factor], design: str, samples: int, levels: int, seed: int) -> np.ndarray:
    """Return the factors' values (n, d) in a problem file's units; fixed factors are the same in every sample.

    In a Latin hypercube, each factor's range is divided into intervals of equal probability, and each interval has one
    sample (McKay, Beckman and Conover, Technometrics 21, 1979). The samples are `N_HYPERCUBES` independent hypercubes, whose
    means tell how certain the mean of all is (Iman & Conover, Communications in Statistics A 9, 1980). A grid has `levels`
    values of each factor, even from end to end of its range: the central 95 % of a normal distribution.

    Raises:
        ProblemError: if a grid has more than `MOST_SAMPLES`.
    """
    from scipy.stats import qmc

    random = [i for i, factor in enumerate(factors) if factor.spread.random]
    if design == "grid":
        count = levels ** len(random)
        if count > MOST_SAMPLES:
            raise ProblemError(
                f"a grid of {levels} levels in {len(random)} factors has {count:.3g} samples, at most {MOST_SAMPLES}; a"
                " Latin hypercube takes any number"
            )
        even = np.linspace(0.0, 1.0, levels) if levels > 1 else np.full(1, 0.5)
        chances = np.array(list(itertools.product(even, repeat=len(random)))).reshape(count, len(random))
    elif random:
        rng = np.random.default_rng(np.random.SeedSequence(seed))
        sizes = np.bincount(replicate_of(samples))
        chances = np.vstack([qmc.LatinHypercube(len(random), rng=rng).random(int(size)) for size in sizes])
    else:
        chances = np.zeros((samples, 0))
    values = np.tile([factor.spread.first for factor in factors], (len(chances), 1)).reshape(len(chances), len(factors))
    for column, i in enumerate(random):
        quantity = factors[i].quantity
        at = even_across if design == "grid" else at_chance
        values[:, i] = np.clip(at(factors[i].spread, chances[:, column]), quantity.low, quantity.high)
    return values


def replicate_of(samples: int) -> np.ndarray:
    """Return the number (n,) of the Latin hypercube that each sample belongs to: `N_HYPERCUBES` in turn, of equal size."""
    count = min(N_HYPERCUBES, samples)
    return np.arange(samples) * count // samples


def even_across(spread: Spread, share: np.ndarray) -> np.ndarray:
    """Return values (n,) at shares from 0 to 1 of a distribution's range, a normal one's central 95 %."""
    low, high = at_chance(spread, np.array([0.0, 1.0] if spread.kind == "uniform" else [0.025, 0.975]))
    return low + share * (high - low)


def at_chance(spread: Spread, chance: np.ndarray) -> np.ndarray:
    """Return the quantiles of a distribution at probabilities between 0 and 1."""
    from scipy.stats import norm

    if spread.kind == "uniform":
        return spread.first + chance * (spread.second - spread.first)
    return spread.first + spread.second * norm.ppf(chance)
