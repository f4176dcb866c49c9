"""The maximum velocity curve of one degree of freedom: the least of the speed limits and the end of the room for efforts.

Above the end of the room no effort satisfies all limits. The curve has a kink where a limited quantity does not depend on an
effort, such as a rocker's acceleration at its dead centre (zero-inertia point: Pfeiffer & Johanni, IEEE J. Robotics and
Automation 3, 1987). Its excess over the motion's own acceleration jumps there from negative to positive.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from linkplan.planner.phase_plane.leg_field import POSES_PER_PART, LegField

# The step of the velocity curve's slope, as a share of the interval in which the slope is examined.
_SLOPE_STEP = 1e-3
# The excess that is due to the rounding of the curve's slope, as a share of its squared speed over the span.
_EXCESS_ROUNDING = 1e-6
# Each round of the search for the largest feasible speeds evaluates about this number of speeds, at all positions together.
_SPEED_SECTIONS = 64


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class MaximumVelocity:
    """The curve of a field along a part with a `span`; `most` is a speed that no motion reaches."""

    field: LegField
    span: float
    most: float

    def at(self, place: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the maximum velocity curve (...), and the joint (...) at its speed limit there; -1 if the room vanishes.

        The curve is the least of the speed limits, and of the speed above which no effort satisfies all limits.
        """
        curve, shape = self.field.velocity_curve, np.shape(place)
        top, joint = (np.full(shape, np.inf), np.full(shape, -1)) if curve is None else curve.at(place)
        if self.field.affine is None:
            return top, joint
        at, parts = np.asarray(place)[..., None], max(2, _SPEED_SECTIONS // max(np.size(place), 1))
        low, width, inner = np.zeros(shape), np.minimum(top, self.most), np.arange(1, parts)
        with np.errstate(all="ignore"):
            bounded = self.field.room(place, self.field.way * width) < 0
            for _ in range(int(np.ceil(53 / np.log2(parts)))):  # to rounding
                width = width / parts
                roomy = self.field.room(at, self.field.way * (low[..., None] + width[..., None] * inner)) >= 0
                low = low + width * np.minimum.accumulate(roomy, axis=-1).sum(axis=-1)
        return np.where(bounded, low, top), np.where(bounded, -1, joint)

    def excess(self, place: Any, *, towards: bool, between: float | None = None) -> np.ndarray:
        """Return the acceleration along the velocity curve minus that under full effort towards the end, or full braking.

        Where the room vanishes the curve's slope is a difference over a short step beside a distance `between` positions.
        """
        field, way = self.field, self.field.way
        step = _SLOPE_STEP * (self.span / POSES_PER_PART if between is None else between)
        with np.errstate(all="ignore"):  # the curve may be infinite at some places
            beside = np.asarray(place)[..., None] + step * np.array([-1.0, 0.0, 1.0])
            tops, joints = self.at(beside)
            top, joint = tops[..., 1], joints[..., 1]
            slope = (np.square(tops[..., 2]) - np.square(tops[..., 0])) / (4 * step)
            if field.velocity_curve is not None:
                slope = np.where(joint < 0, slope, field.velocity_curve.acceleration(place, top, np.maximum(joint, 0)))
            excess = way * (slope - field.at(place, way * top, towards=towards)[2])
            return np.where((joint < 0) & (np.abs(excess) < _EXCESS_ROUNDING * top**2 / self.span), 0.0, excess)

    def sign_change(self, places: np.ndarray, *, towards: bool, sign: float) -> float:
        """Return the first of positions (n,), refined, at which the excess has a given sign; otherwise the last one.

        The excess may jump at the position, where the curve has a kink.
        """
        has = sign * self.excess(places, towards=towards) > 0
        k = int(np.argmax(has))
        if not has.any() or k == 0:
            return float(places[-1] if not has.any() else places[0])
        before, after = places[k - 1], places[k]
        for _ in range(10):  # to rounding
            inner = np.linspace(before, after, 17)
            found = sign * self.excess(inner[1:], towards=towards, between=abs(after - before) / 16) > 0
            k = int(np.argmax(found)) if found.any() else 15
            before, after = inner[k : k + 2]
        return float(after)
