"""The samples of an experiment: a Latin hypercube or a grid over its random factors."""

import itertools
from collections.abc import Sequence

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.planner.problem.imperfections import Factor, Spread
from linkplan.studies.sensitivity.scheme import SENSITIVE

# The first two designs compare trackers over the machines. The others measure the influence of each imperfection.
DESIGNS = ("latin-hypercube", "grid", *SENSITIVE)
# Most samples of an experiment: more are probably a typing error.
MOST_SAMPLES = 1_000_000


def values_of(factors: Sequence[Factor], design: str, samples: int, levels: int, seed: int) -> np.ndarray:
    """Return the factors' values (n, d) in a problem file's units; fixed factors are the same in every sample.

    In a Latin hypercube, each factor's range is divided into n intervals of equal probability, and each interval has one
    sample (McKay, Beckman and Conover, Technometrics 21, 1979). A grid has `levels` values of each factor, at the middles
    of intervals of equal probability.

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
        middles = (np.arange(levels) + 0.5) / levels
        chances = np.array(list(itertools.product(middles, repeat=len(random)))).reshape(count, len(random))
    elif random:
        chances = qmc.LatinHypercube(len(random), rng=np.random.default_rng(np.random.SeedSequence(seed))).random(samples)
    else:
        chances = np.zeros((samples, 0))
    values = np.tile([factor.spread.first for factor in factors], (len(chances), 1)).reshape(len(chances), len(factors))
    for column, i in enumerate(random):
        quantity = factors[i].quantity
        values[:, i] = np.clip(at_chance(factors[i].spread, chances[:, column]), quantity.low, quantity.high)
    return values


def at_chance(spread: Spread, chance: np.ndarray) -> np.ndarray:
    """Return the quantiles of a distribution at probabilities between 0 and 1."""
    from scipy.stats import norm

    if spread.kind == "uniform":
        return spread.first + chance * (spread.second - spread.first)
    return spread.first + spread.second * norm.ppf(chance)
