"""The machines of an experiment: their random factors' values and noise draws, by a design."""

import itertools
from collections.abc import Sequence

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.planner.problem.imperfections import Factor, Spread
from linkplan.studies.variations.sensitivity.influence import NORMAL_QUANTILE
from linkplan.studies.variations.sensitivity.scheme import SENSITIVE, SOBOL, SamplingScheme, scheme_of

# The first two designs compare trackers over the machines. The others measure the influence of each imperfection.
LATIN_HYPERCUBE = "latin-hypercube"
DESIGNS = (LATIN_HYPERCUBE, "grid", *SENSITIVE)
# Independent Latin hypercubes of an experiment: their means give the confidence intervals.
N_HYPERCUBES = 10
# Most samples of an experiment: more are probably a typing error.
MOST_SAMPLES = 1_000_000
# Imperfections that are noise amplitudes. Their noise differs even between machines with equal factors.
_NOISES = ("position_noise", "velocity_noise")
# Probabilities are kept this far from 0 and 1, where a normal value is infinite: one step of Sobol's sequence.
_MIN_PROBABILITY = 2.0**-31


def machines_by_design(
    factors: Sequence[Factor], design: str, samples: int, levels: int, seed: int
) -> tuple[np.ndarray, np.ndarray, SamplingScheme | None]:
    """Return the factors' values (n, d) in a problem file's units, noise draws (n,), and a sensitivity design's scheme.

    Fixed factors are the same in every sample. In a Latin hypercube, each factor's range is divided into intervals of equal
    probability, and each interval has one sample (McKay, Beckman and Conover, Technometrics 21, 1979). The samples are
    `N_HYPERCUBES` independent hypercubes, whose means give the uncertainty of the overall mean (Iman & Conover,
    Communications in Statistics A 9, 1980). A grid has `levels` values of each factor, evenly spaced over its range, for a
    normal distribution over its central 95 %.

    Raises:
        ProblemError: for more than `MOST_SAMPLES`, or too few for a sensitivity design.
        LinkplanError: if the package for the design is not installed.
    """
    random, scheme = varied(factors), None
    if design in SENSITIVE:
        scheme = scheme_of(design, len(random), noisy(factors), samples, seed)
        shares = scheme.points
        if len(shares) > MOST_SAMPLES:
            raise ProblemError(f"the design '{design}' has {len(shares)} samples here, at most {MOST_SAMPLES}")
    elif design == "grid":
        shares = _grid(len(random), levels)
    else:
        shares = _hypercubes(len(random), samples, seed)
    values = np.tile([factor.spread.first for factor in factors], (len(shares), 1)).reshape(len(shares), len(factors))
    for column, i in enumerate(random):
        quantity, share = factors[i].quantity, shares[:, column]
        if design == LATIN_HYPERCUBE:
            value = at_chance(factors[i].spread, share)
        elif design == SOBOL:
            value = at_chance(factors[i].spread, np.clip(share, _MIN_PROBABILITY, 1 - _MIN_PROBABILITY))
        else:
            low, high = ends_of(factors[i])
            value = low + share * (high - low)
        values[:, i] = np.clip(value, quantity.low, quantity.high)
    return values, np.arange(len(values)) if scheme is None else scheme.draws, scheme


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
        ends = spread.first - NORMAL_QUANTILE * spread.second, spread.first + NORMAL_QUANTILE * spread.second
        return max(ends[0], factor.quantity.low), min(ends[1], factor.quantity.high)
    return spread.first, spread.second


def noisy(factors: Sequence[Factor]) -> bool:
    """Return True if the sensors have noise."""
    return any(factor.key.startswith(_NOISES) and (factor.spread.random or factor.spread.first > 0) for factor in factors)


def at_chance(spread: Spread, chance: np.ndarray) -> np.ndarray:
    """Return the quantiles of a distribution at probabilities between 0 and 1."""
    from scipy.stats import norm

    if spread.kind == "uniform":
        return spread.first + chance * (spread.second - spread.first)
    return spread.first + spread.second * norm.ppf(chance)
