"""The machines of an experiment: their factors' values, and which draw of the noise each one has."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.planner.problem.imperfections import Factor, Spread
from linkplan.studies.experiment.design import MOST_SAMPLES, at_chance, values_of
from linkplan.studies.sensitivity.influence import ENDS
from linkplan.studies.sensitivity.scheme import SENSITIVE, SOBOL, Scheme, scheme_of

# Imperfections that are sizes of a noise: two machines alike in everything differ in what it happens to be.
_NOISES = ("position_noise", "velocity_noise")
# Chances stay off 0 and 1, where a normal value has no end: by the step of Sobol's sequence.
_NEVER = 2.0**-31


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Layout:
    """Values (n, d) of factors in a problem file's units, noise draws (n,), and what tells influences apart, if anything."""

    values: np.ndarray
    draws: np.ndarray
    scheme: Scheme | None = None


def layout_of(factors: Sequence[Factor], design: str, samples: int, levels: int, seed: int) -> Layout:
    """Return where the machines of a design lie.

    Raises:
        ProblemError: when there are too many, or too few to tell influences apart.
        LinkplanError: when what makes the design is not installed.
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
            value = at_chance(spread, np.clip(share, _NEVER, 1 - _NEVER))
        else:
            low, high = ends_of(factors[i])
            value = low + share * (high - low)
        values[:, i] = np.clip(value, quantity.low, quantity.high)
    return Layout(values=values, draws=scheme.draws, scheme=scheme)


def varied(factors: Sequence[Factor]) -> list[int]:
    """Return which factors differ from machine to machine."""
    return [i for i, factor in enumerate(factors) if factor.spread.random]


def ends_of(factor: Factor) -> tuple[float, float]:
    """Return the ends of a factor's range: of a normal one those between which it lies 95 times of 100."""
    spread: Spread = factor.spread
    if spread.kind == "normal":
        ends = spread.first - ENDS * spread.second, spread.first + ENDS * spread.second
        return max(ends[0], factor.quantity.low), min(ends[1], factor.quantity.high)
    return spread.first, spread.second


def noisy(factors: Sequence[Factor]) -> bool:
    """Return whether there is noise in the sensors, of which one draw differs from another."""
    return any(factor.key.startswith(_NOISES) and (factor.spread.random or factor.spread.first > 0) for factor in factors)
