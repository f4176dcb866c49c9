"""The machines of an experiment: their factors' values and noise draws."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.planner.problem.imperfections import Factor, Spread
from linkplan.studies.experiment.design import MOST_SAMPLES, at_chance, values_of
from linkplan.studies.sensitivity.influence import NORMAL_QUANTILE
from linkplan.studies.sensitivity.scheme import SENSITIVE, SOBOL, Scheme, scheme_of

# Imperfections that are noise amplitudes. Their noise differs even between machines with equal factors.
_NOISES = ("position_noise", "velocity_noise")
# Probabilities are kept this far from 0 and 1, where a normal value is infinite: one step of Sobol's sequence.
_MIN_PROBABILITY = 2.0**-31


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Layout:
    """Values (n, d) of factors in a problem file's units, noise draws (n,), and the scheme of a sensitivity design."""

    values: np.ndarray
    draws: np.ndarray
    scheme: Scheme | None = None


def layout_of(factors: Sequence[Factor], design: str, samples: int, levels: int, seed: int) -> Layout:
    """Return the machines of a design.

    Raises:
        ProblemError: for too many machines, or too few for a sensitivity design.
        LinkplanError: if the package for the design is not installed.
    """
    if design not in SENSITIVE:
        values = values_of(factors, design, samples, levels, seed)
        return Layout(values=values, draws=np.arange(len(values)))
    scheme = scheme_of(design, len(varied(factors)), noisy(factors), samples, seed)
    if len(scheme.points) > MOST_SAMPLES:
        raise ProblemError(f"the design '{design}' has {len(scheme.points)} samples here, at most {MOST_SAMPLES}")
    values = np.tile([factor.spread.first for factor in factors], (len(scheme.points), 1))
    for column, i in enumerate(varied(factors)):
        spread, quantity, share = factors[i].spread, factors[i].quantity, scheme.points[:, column]
        if design == SOBOL:
            value = at_chance(spread, np.clip(share, _MIN_PROBABILITY, 1 - _MIN_PROBABILITY))
        else:
            low, high = ends_of(factors[i])
            value = low + share * (high - low)
        values[:, i] = np.clip(value, quantity.low, quantity.high)
    return Layout(values=values, draws=scheme.draws, scheme=scheme)


def varied(factors: Sequence[Factor]) -> list[int]:
    """Return the indices of the factors that differ between machines."""
    return [i for i, factor in enumerate(factors) if factor.spread.random]


def ends_of(factor: Factor) -> tuple[float, float]:
    """Return the ends of a factor's range; for a normal distribution, of its central 95 % interval."""
    spread: Spread = factor.spread
    if spread.kind == "normal":
        ends = spread.first - NORMAL_QUANTILE * spread.second, spread.first + NORMAL_QUANTILE * spread.second
        return max(ends[0], factor.quantity.low), min(ends[1], factor.quantity.high)
    return spread.first, spread.second


def noisy(factors: Sequence[Factor]) -> bool:
    """Return True if the sensors have noise."""
    return any(factor.key.startswith(_NOISES) and (factor.spread.random or factor.spread.first > 0) for factor in factors)
