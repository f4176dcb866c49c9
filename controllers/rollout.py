"""The log of one machine's run, and the properties of its feedback loop.

Numpy's and MuJoCo's warnings are suppressed in runs that may diverge; the logs record the divergence.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from linkplan.models.library import mujoco_warnings

# Commands at the rate limit exceed it by rounding.
_RATE_ROUNDING = 1e-9


@contextlib.contextmanager
def divergence_expected() -> Iterator[None]:
    """Silence warnings about overflow and diverging simulations. Decorates functions that run a feedback loop."""
    with mujoco_warnings(), np.errstate(all="ignore"):
        yield


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ControlLoop:
    """The feedback loop's properties between a tracker and the mechanism.

    `effort_limit` (n_u, 2) [N.m or N] saturates commands. `motor_line` (n_u, 2) are stall efforts and no-load speeds, which
    limit efforts at every speed, and `rate_limit` (n_u,) [per second] their changes; infinite without a limit.
    `initial_effort` (n_u,) are efforts before the first command, infinite where they hold the start at rest. A command
    acts after `delay_periods`, which may be a fraction. `mass_factor` multiplies the payload's mass and inertia, or those of
    all moving bodies if there is no payload.
    """

    effort_limit: np.ndarray
    motor_line: np.ndarray | None = None
    rate_limit: np.ndarray | None = None
    initial_effort: np.ndarray | None = None
    delay_periods: float = 0
    mass_factor: float = 1.0

    def saturates(self, commanded: np.ndarray, period_s: float, held: np.ndarray) -> np.ndarray:
        """Return a mask (n,) of instants at which a drive without delay cannot give the commands (n, n_u).

        A command is beyond a limit on the effort, or farther from the effort before it than the rate limit allows within a
        period; `held` (n_u,) is the effort before the first command.
        """
        low, high = self.effort_limit.T
        beyond = np.any((commanded < low) | (commanded > high), axis=1)
        if self.rate_limit is None or not np.isfinite(self.rate_limit).any():
            return beyond
        step, given = self.rate_limit * period_s * (1 + _RATE_ROUNDING), held
        for k, command in enumerate(np.clip(commanded, low, high)):
            given = np.clip(command, given - step, given + step)
            beyond[k] |= np.any(given != command)
        return beyond


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Rollout:
    """The log of a run at its control instants (n,), and the conditions of the simulation.

    Positions are in rad, those of slides in m. `commanded` is the tracker's output and `applied` the mean effort of the
    period, both (n, n_u) [N.m or N]. `gap_m` (n,) is the largest distance between points or slides that a closure ties;
    `gap_rad` (n,) is the largest gap of tied angles, empty if there are none. `failure` is the reason why the log ends
    early, None if it does not. `saturated` (n,) is True where the drives' limits on effort or rate do not allow the command.
    `asked_s` (n,) [s] is the measured computing time of the tracker. `returns` is False if a machine that starts beside a
    pose at rest moves away from one that starts in it.
    """

    tracker: str
    time_s: np.ndarray
    position_rad: np.ndarray
    velocity_rad_s: np.ndarray
    reference_rad: np.ndarray
    pose_rad: np.ndarray
    commanded: np.ndarray
    applied: np.ndarray
    gap_m: np.ndarray
    contacts: int
    failure: str | None
    effort_limit: np.ndarray
    conditions: dict
    asked_s: np.ndarray = field(default_factory=lambda: np.empty(0))
    gap_rad: np.ndarray = field(default_factory=lambda: np.empty(0))
    saturated: np.ndarray = field(default_factory=lambda: np.zeros(1, dtype=bool))
    returns: bool = True

    @property
    def finite(self) -> bool:
        """True if the run has not ended early."""
        return self.failure is None

    @property
    def error_rad(self) -> np.ndarray:
        """The position error s_ref - s (n, n_s) [rad, or m of slides]."""
        return self.reference_rad - self.position_rad

    @property
    def largest_gaps(self) -> tuple[float, float]:
        """The largest closure gaps of the run: [m] of points and slides, [rad] of angles."""
        return float(self.gap_m.max()), float(self.gap_rad.max(initial=0.0))

    @property
    def saturated_fraction(self) -> float:
        """The share of control instants with a command that the drives cannot give."""
        return float(np.mean(self.saturated))

    @property
    def stable(self) -> bool:
        """True if the run stayed finite without a limit cycle between effort limits, and returns to a pose at rest."""
        return self.finite and self.returns and not any(self._is_limit_cycle(j) for j in range(self.applied.shape[1]))

    def _is_limit_cycle(self, j: int) -> bool:
        """Return True if an effort swings between its limits at least 6 times, and at 2 % of all instants or more.

        A swing is a change from one limit to the other within 10 control periods. A bang-bang plan has one or two swings.
        """
        low, high = self.effort_limit[j]
        at = np.where(self.applied[:, j] >= high, 1, np.where(self.applied[:, j] <= low, -1, 0))
        touched = np.flatnonzero(at)
        near = np.diff(touched) <= 10
        count = int(np.sum(near & (at[touched[1:]] != at[touched[:-1]])))
        return count >= max(6, 0.02 * len(at))
