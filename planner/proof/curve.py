"""Enclosures of a curve over time that a table gives: a reference, or an external force."""

from collections.abc import Iterator

import numpy as np
from flint import arb

from linkplan.models.external_forces import ForcesOverTime
from linkplan.planner.problem.table_reference import Spline
from linkplan.planner.proof.walk import Ball, constant_term, known_to

# A ball of times may reach beyond a piece by this share of the curve's length: rounding of a trajectory's breaks.
_ROUNDING_SHARE = 1e-9


def forces_over(forces: ForcesOverTime, time: Ball) -> list[list[Ball]]:
    """Return enclosures of external forces over a ball of times, in the form of `Mechanism.forces_at`."""
    assert isinstance(forces.curve, Spline)
    return [[enclosed(forces.curve, k, time) for k in range(3 * len(forces.sites))]]


def enclosed(curve: Spline, column: int, time: Ball) -> Ball:
    """Return an enclosure (a ball, or a series if `time` is one) of a column of a curve over a ball of times.

    If the ball overlaps several pieces, a series has bounds on its coefficients up to the first derivative that jumps.
    """
    box, slack = constant_term(time), _ROUNDING_SHARE * curve.period_s
    low, high, middle = float(box.lower()) + slack, float(box.upper()) - slack, float(box.mid())
    pieces = list(_pieces(curve, low, high) if low < high else _pieces(curve, middle, middle))
    values: list[Ball] = []
    for k, begin in pieces:
        value: Ball = 0 * time
        for coefficient in curve.coefficients[:, k, column]:
            value = value * (time - begin) + float(coefficient)
        values.append(value)
    # Rounding may exceed a piece's end. There its polynomial leaves the curve at most by the difference of two slopes.
    last, begin = pieces[-1]
    end = begin - arb(float(curve.knots_s[last])) + arb(float(curve.knots_s[last + 1]))
    beyond = arb(0).max(pieces[0][1] - box.lower()).max(box.upper() - end)
    steepest = 4 * float(np.abs(curve.coefficients[2, :, column]).max())
    rounding = arb(0, (beyond * steepest).abs_upper())
    if len(values) == 1:
        return values[0] + rounding
    n = 4 if np.any(curve.coefficients[:2, :, column]) else 2  # the third derivative of a cubic spline jumps
    hull = [constant_term(values[0])]
    if not isinstance(time, arb):
        hull = [values[0][j] for j in range(min(n, time.prec))]
    for value in values[1:]:
        hull = [one.union(value[j] if j else constant_term(value)) for j, one in enumerate(hull)]
    return known_to(hull, time) + rounding


def _pieces(curve: Spline, low: float, high: float) -> Iterator[tuple[int, arb]]:
    """Yield the pieces that overlap the times from low to high, each with the time [s] at which it begins."""
    T, knots = curve.period_s, curve.knots_s
    if not curve.periodic:
        low, high = (min(max(at, 0.0), T) for at in (low, high))
    for period in range(int(np.floor(low / T)), int(np.floor(high / T)) + 1) if curve.periodic else (0,):
        first = np.searchsorted(knots, low - period * T, side="right") - 1
        last = max(first, np.searchsorted(knots, high - period * T, side="left") - 1)
        for k in range(max(first, 0), min(last, len(knots) - 2) + 1):
            yield k, arb(float(knots[k])) + period * arb(T)
        if first > len(knots) - 2 and not curve.periodic:  # at its end
            yield len(knots) - 2, arb(float(knots[-2]))
