"""A claim on every instant of a motion: a quantity as a series, and the interval in which it lies."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.planner.certificate.certificate import end_sizes
from linkplan.planner.proof.motion import Kinetics, State
from linkplan.planner.proof.walk import Ball


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Claim:
    """low - slack[0] <= f(t) <= high + slack[1] at every instant. All `values` of a state have to keep it.

    Numbers are SI; `per_unit` times them is in `unit`.
    """

    name: str
    unit: str
    low: float
    high: float
    slack: tuple[float, float]
    values: Callable[[State], list[Ball]]
    per_unit: float = 1.0

    @property
    def marks(self) -> tuple[float, float]:
        """The limits with their allowances."""
        return self.low - self.slack[0], self.high + self.slack[1]


def claim_of(
    name: str,
    unit: str,
    bounds: Sequence[float],
    values: Callable[[State], list[Ball]],
    slack: tuple[float, float] | None = None,
    per_unit: float = 1.0,
) -> Claim:
    """Return the claim that values lie within [low, high], by default with the allowances for rounding."""
    low, high = (float(x) for x in bounds)
    given = rounding_of((low, high)) if slack is None else slack
    return Claim(name=name, unit=unit, low=low, high=high, slack=given, values=values, per_unit=per_unit)


def share_of(bounds: Sequence[float], share: float) -> tuple[float, float]:
    """Return the allowances of [low, high]: a share of each end, and for an end at zero of the other end."""
    low, high = share * end_sizes(np.reshape(bounds, (1, 2)))[0]
    return float(low), float(high)


def rounding_of(bounds: Sequence[float]) -> tuple[float, float]:
    """Return the allowances of [low, high] for rounding, as in the certificate: 1e-9, or 1e-9 of an end above one."""
    low, high = (max(1.0, abs(float(x))) if np.isfinite(x) else 0.0 for x in bounds)
    return ROUNDING_SHARE * low, ROUNDING_SHARE * high


def of_kinetics(of: Callable[[Kinetics], Ball]) -> Callable[[State], list[Ball]]:
    """Return the values of a quantity for a motion's one or two kinetics."""
    return lambda state: [of(kinetics) for kinetics in state.kinetics]
