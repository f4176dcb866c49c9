"""A motion as continuous functions of time: piecewise polynomials of position, velocity and effort."""

from dataclasses import dataclass, field

import numpy as np

from linkplan.planner.transcription.bernstein import OnIntervals, PiecewisePolynomial

# A change of acceleration from one interval to the next, or from rest, that is below this share of the largest acceleration
# is rounding and no jump.
NO_JUMP_SHARE = 1e-7
# A speed below this share of the largest is rest.
_REST_SHARE = 1e-9

# Largest jump between two pieces, and largest difference of a planned velocity from the slope of the position, as a share
# of the motion's span or largest speed: rounding of the program's solution. Measured: 2e-10 on fine meshes.
JOIN_SHARE = 1e-8
# The same for first-order schemes, whose slopes and velocities differ by their own order, and for the integrated velocity.
VELOCITY_SHARE = 0.02
# The rounding of coefficients of positions, in units of their last place: three times the largest measured on fine meshes.
_ROUNDED_PLACES = 8.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Trajectory(OnIntervals):
    """Independent positions s(t), their velocity v(t) = s'(t), and efforts u(t), over [0, duration].

    `breaks_s` (n + 1,) are the intervals' ends. Coefficients are Bernstein's on each interval: `position`
    (degree + 1, n, n_s) [rad or m], `velocity` (degree + 1, n, n_s), `effort` (degree + 1, n, n_u) [N.m or N]. Efforts may
    jump at a break, where the later interval's value holds. `start_pose` (n_q,) is the closed pose at the start: with s(t)
    it determines the dependent joints. `along` (degree + 1, n, 1) is the parameter of the path that a site follows [m], or
    (1, n, 0) without a path. A `periodic` motion continues beyond its ends, shifted by `advance` per period; any
    other motion rests at its end states.
    """

    breaks_s: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray
    start_pose: np.ndarray
    periodic: bool
    along: np.ndarray = field(default_factory=lambda: np.zeros((1, 0, 0)))

    def __post_init__(self) -> None:
        for name in ("breaks_s", "position", "velocity", "effort", "start_pose", "along"):
            value = np.array(getattr(self, name), dtype=float)
            if not np.all(np.isfinite(value)):
                raise ValueError(f"trajectory.{name} has values that are not finite")
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        pieces = ("position", "velocity", "effort", "along")
        dimensions = [getattr(self, name).ndim for name in ("breaks_s", *pieces, "start_pose")]
        if dimensions != [1, 3, 3, 3, 3, 1]:
            raise ValueError(f"trajectory has arrays of {dimensions} dimensions in place of [1, 3, 3, 3, 3, 1]")
        if len(self.position) < 2 or not all(len(getattr(self, name)) for name in pieces):
            raise ValueError("trajectory polynomials lack coefficients")
        n = len(self.breaks_s) - 1
        if not self.along.size:
            object.__setattr__(self, "along", np.zeros((1, max(n, 0), 0)))
        shapes = [getattr(self, name).shape[1] for name in pieces]
        if n < 1 or np.any(np.diff(self.breaks_s) <= 0) or shapes != [n] * len(pieces):
            raise ValueError(f"trajectory has {n} intervals, its coefficients {shapes}; breaks must increase")

    @property
    def n_s(self) -> int:
        """The number of independent joints."""
        return self.position.shape[2]

    @property
    def n_u(self) -> int:
        """The number of actuators."""
        return self.effort.shape[2]

    def misfit(self, n_s: int, n_u: int, n_q: int) -> str:
        """Return how the motion differs from one of n_s independent joints, n_u actuators and n_q joints, or ""."""
        sizes = {
            "positions of independent joints": (self.n_s, n_s),
            "velocities of independent joints": (self.velocity.shape[2], n_s),
            "efforts of actuators": (self.n_u, n_u),
            "joints in its start pose": (len(self.start_pose), n_q),
        }
        return "; ".join(
            f"it has {has} {what}, the mechanism {needs}" for what, (has, needs) in sizes.items() if has != needs
        )

    @property
    def advance(self) -> np.ndarray:
        """The change of positions (n_s,) [rad] over a period of a periodic motion: whole turns, or 0."""
        travelled = self.position[-1, -1] - self.position[0, 0]
        return self.periodic * 2 * np.pi * np.round(travelled / (2 * np.pi))

    def periods_at(self, time_s: np.ndarray) -> np.ndarray:
        """Return the number of whole periods (n,) passed at times (n,); 0 for a motion that is not periodic."""
        return self.periodic * np.floor_divide(np.asarray(time_s, dtype=float) - self.breaks_s[0], self.duration_s)

    def times_within(self, time_s: np.ndarray) -> np.ndarray:
        """Return times (n,) mapped into the motion: by whole periods where it is periodic, else to the nearer end."""
        time = np.asarray(time_s, dtype=float)
        if self.periodic:
            return self.breaks_s[0] + np.mod(time - self.breaks_s[0], self.duration_s)
        return np.clip(time, self.breaks_s[0], self.breaks_s[-1])

    def position_at(self, time_s: np.ndarray) -> np.ndarray:
        """Return s (n, n_s) [rad or m] at times (n,)."""
        within = PiecewisePolynomial(self.position, self.breaks_s)(self.times_within(time_s))
        return within + self.periods_at(time_s)[:, None] * self.advance

    def velocity_at(self, time_s: np.ndarray) -> np.ndarray:
        """Return v (n, n_s) [rad/s or m/s] at times (n,); zero outside a motion that is not periodic."""
        velocity = PiecewisePolynomial(self.velocity, self.breaks_s)(self.times_within(time_s))
        return np.where(self._inside(time_s)[:, None], velocity, 0.0)

    def slope_at(self, time_s: np.ndarray) -> np.ndarray:
        """Return s' (n, n_s), the slope of the planned position; it equals v except for first-order schemes."""
        return PiecewisePolynomial(self.position, self.breaks_s).derivative()(self.times_within(time_s))

    def slope_rounding(self) -> np.ndarray:
        """Return the errors of s' (n_intervals, n_s) due to the rounding of positions, which short intervals amplify."""
        places = _ROUNDED_PLACES * np.finfo(float).eps * np.abs(self.position).max(axis=0)
        return (len(self.position) - 1) * places / np.diff(self.breaks_s)[:, None]

    def slope_errors(self, time_s: np.ndarray) -> np.ndarray:
        """Return |s' - v| (n, n_s) at times (n,) of the motion, less what is due to rounding."""
        index = np.searchsorted(self.breaks_s[1:-1], time_s, side="right")
        apart = np.abs(self.slope_at(time_s) - self.velocity_at(time_s))
        return np.maximum(apart - self.slope_rounding()[index], 0.0)

    @property
    def slope_share(self) -> float:
        """The allowed difference of s' from v, as a share of the largest speed."""
        return JOIN_SHARE if len(self.position) == len(self.velocity) + 1 else VELOCITY_SHARE

    def bend_at(self, time_s: np.ndarray) -> np.ndarray:
        """Return s'' (n, n_s) of the planned position; it equals v' except for first-order schemes."""
        slope = PiecewisePolynomial(self.position, self.breaks_s).derivative()
        return slope.derivative()(self.times_within(time_s))

    def acceleration_at(self, time_s: np.ndarray) -> np.ndarray:
        """Return v' (n, n_s) [rad/s2 or m/s2] at times (n,); zero outside a motion that is not periodic."""
        acceleration = PiecewisePolynomial(self.velocity, self.breaks_s).derivative()(self.times_within(time_s))
        return np.where(self._inside(time_s)[:, None], acceleration, 0.0)

    def __repr__(self) -> str:
        return f"Trajectory({len(self.breaks_s) - 1} intervals, {self.duration_s:.6g} s)"

    def jerk_at(self, time_s: np.ndarray) -> np.ndarray:
        """Return v'' (n, n_s) [rad/s3 or m/s3] within the intervals at times (n,); zero outside as the acceleration."""
        velocity = PiecewisePolynomial(self.velocity, self.breaks_s)
        with np.errstate(over="ignore", invalid="ignore"):  # the duration in an edited file may be 1e-200 s
            jerk = velocity.derivative().derivative()(self.times_within(time_s))
        return np.where(self._inside(time_s)[:, None], jerk, 0.0)

    def acceleration_jumps(self) -> np.ndarray:
        """Return the changes of acceleration (n_breaks, n_s) [rad/s2 or m/s2] at the breaks; rounding is zero.

        The first and the last are those from and to rest, zero for a joint that moves there. Those of a periodic motion are
        the change to the next period, and zero.
        """
        coefficients = PiecewisePolynomial(self.velocity, self.breaks_s).derivative().coefficients
        before, after = coefficients[-1], coefficients[0]
        if self.periodic:
            steps = np.vstack([after - np.roll(before, 1, axis=0), np.zeros((1, self.n_s))])
        else:
            rest = np.abs(self.velocity[[0, -1], [0, -1]]) <= _REST_SHARE * np.abs(self.velocity).max()
            steps = np.vstack([rest[0] * after[0], after[1:] - before[:-1], rest[1] * -before[-1]])
        size = NO_JUMP_SHARE * max(float(np.abs(coefficients).max()), float(np.finfo(float).tiny))
        return np.where(np.abs(steps) > size, steps, 0.0)

    def along_at(self, time_s: np.ndarray) -> np.ndarray:
        """Return the parameter (n,) [m] of the followed path at times (n,); infinite for a motion without one."""
        found = PiecewisePolynomial(self.along, self.breaks_s)(self.times_within(time_s))
        return found[:, 0] if self.along.size else np.full(len(found), np.inf)

    def effort_at(self, time_s: np.ndarray) -> np.ndarray:
        """Return u (n, n_u) [N.m or N] at times (n,); outside the motion that of the nearer end."""
        return PiecewisePolynomial(self.effort, self.breaks_s)(self.times_within(time_s))

    def _inside(self, time_s: np.ndarray) -> np.ndarray:
        time = np.asarray(time_s, dtype=float)
        slack = 1e-12 * max(1.0, self.duration_s)
        return self.periodic | ((time >= self.breaks_s[0] - slack) & (time <= self.breaks_s[-1] + slack))
