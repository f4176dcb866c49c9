"""The log of one machine's run, and the properties of the loop that it is run in."""

from dataclasses import dataclass, field

import numpy as np

from linkplan.models.mechanism import Mechanism

# An effort that goes from one limit to the other within this many control periods, again and again, is a limit cycle of
# the sampled loop and not a motion; this share of all instants makes the verdict. A bang-bang plan swings once or twice.
_SWING_PERIODS = 10
_SWING_SHARE = 0.02
_FEWEST_SWINGS = 6


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ControlLoop:
    """The feedback loop's properties between a tracker and the mechanism.

    `effort_limit` (n_u, 2) [N.m or N] saturates; `delay_periods` whole control periods pass before a command acts;
    `mass_factor` multiplies the payload's mass and inertia (all moving bodies' where there is no payload).
    """

    effort_limit: np.ndarray
    delay_periods: int = 0
    mass_factor: float = 1.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Rollout:
    """The log of a run at its control instants (n,), and the conditions of the simulation.

    Angles [rad or m]; `commanded` is the tracker's output, `applied` the mean of what acted in the period, both (n, n_u)
    [N.m or N]; `gap_m` (n,) is
    the largest distance between two points that a closure ties, or gap of slides, `gap_rad` (n,) that of angles, empty where
    none are tied; `finite` is False when the simulation blew up, and the log
    ends there. `asked_s` (n,) [s] is how long the tracker took to answer, here and now; no other figure depends on it.
    """

    tracker: str
    time_s: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    reference: np.ndarray
    pose: np.ndarray
    commanded: np.ndarray
    applied: np.ndarray
    gap_m: np.ndarray
    contacts: int
    finite: bool
    effort_limit: np.ndarray
    conditions: dict
    asked_s: np.ndarray = field(default_factory=lambda: np.empty(0))
    gap_rad: np.ndarray = field(default_factory=lambda: np.empty(0))

    @property
    def error(self) -> np.ndarray:
        """The position error s_ref - s (n, n_s) [rad or m]."""
        return self.reference - self.position

    @property
    def largest_gaps(self) -> tuple[float, float]:
        """The largest closure gap of the run, [m] of points and slides, [rad] of angles."""
        return float(self.gap_m.max()), float(self.gap_rad.max(initial=0.0))

    @property
    def saturated_fraction(self) -> float:
        """The share of control instants at which a command went beyond a limit."""
        low, high = self.effort_limit.T
        return float(np.mean(np.any((self.commanded < low) | (self.commanded > high), axis=1)))

    @property
    def stable(self) -> bool:
        """Whether the run stayed finite and no effort swung between its limits over and over."""
        return self.finite and not any(self._swings(j) for j in range(self.applied.shape[1]))

    def _swings(self, j: int) -> bool:
        low, high = self.effort_limit[j]
        at = np.where(self.applied[:, j] >= high, 1, np.where(self.applied[:, j] <= low, -1, 0))
        touched = np.flatnonzero(at)
        near = np.diff(touched) <= _SWING_PERIODS
        count = int(np.sum(near & (at[touched[1:]] != at[touched[:-1]])))
        return count >= max(_FEWEST_SWINGS, _SWING_SHARE * len(at))


def closure_gaps(mechanism: Mechanism, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest gaps at poses (n, n_q): (n,) [m] of points and slides, (n,) [rad] of angles or (0,) without any."""
    gaps = mechanism.gaps_by_unit(poses)
    return gaps.get("m", np.zeros(len(poses))), gaps.get("rad", np.empty(0))
