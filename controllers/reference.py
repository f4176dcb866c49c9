"""The motion that a tracker follows, sampled at its control instants."""

from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import needed_effort, whole_turns
from linkplan.models.poses.assembly import follow
from linkplan.planner.trajectory import Trajectory

_ARRAYS = ("time_s", "pose_rad", "position_rad", "velocity_rad_s", "effort")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SampledReference:
    """A motion at control instants t_k = k T, for k = 0 to n - 1.

    `pose_rad` (n, n_q), `position_rad` and `velocity_rad_s` (n, n_s); slides are in m and m/s.
    `effort` (n, n_u) [N.m or N] comes from the reduced inverse dynamics at the middle of each period, because a held effort
    acts like its mean. `cycle` is the number of samples after which the motion repeats, or None. `forces` are those of
    `Mechanism.forces_at` at the same instants as efforts.
    """

    period_s: float
    time_s: np.ndarray
    pose_rad: np.ndarray
    position_rad: np.ndarray
    velocity_rad_s: np.ndarray
    effort: np.ndarray
    cycle: int | None
    forces: tuple[np.ndarray, ...] = ()

    def __post_init__(self) -> None:
        for name in _ARRAYS:
            value = np.array(getattr(self, name), dtype=float)
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    @property
    def n(self) -> int:
        """The number of control instants."""
        return len(self.time_s)

    @property
    def states(self) -> tuple[np.ndarray, ...]:
        """The dynamics' arguments at the instants (n, ...): poses, velocities, efforts, and forces over time."""
        return self.pose_rad, self.velocity_rad_s, self.effort, *self.forces

    def part(self, which: slice | np.ndarray, cycle: int | None = None) -> "SampledReference":
        """Return a reference of some of the instants, which repeats after `cycle` of them."""
        arrays = {name: getattr(self, name)[which] for name in _ARRAYS}
        return replace(self, cycle=cycle, forces=tuple(w[which] for w in self.forces), **arrays)


def hermite(p0: np.ndarray, v0: np.ndarray, p1: np.ndarray, v1: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the cubic with values p and slopes v at x = 0 and x = 1, and its slope, at x."""
    a, b = 3 * (p1 - p0) - 2 * v0 - v1, 2 * (p0 - p1) + v0 + v1
    return p0 + x * (v0 + x * (a + x * b)), v0 + x * (2 * a + 3 * x * b)


def state_at(reference: SampledReference, time_s: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return position and velocity (..., n_s) at times (...) [s] by cubic Hermite interpolation.

    After the last sample the motion continues at its last velocity. At a sample the result is exact.
    """
    T = reference.period_s
    time = np.asarray(time_s, dtype=float)
    k = np.clip(np.floor(time / T + 1e-9).astype(int), 0, reference.n - 1)
    after = np.minimum(k + 1, reference.n - 1)
    x = (time / T - k)[..., None]
    x = np.where(np.abs(x) < 1e-9, 0.0, x)
    p0, v0 = reference.position_rad[k], T * reference.velocity_rad_s[k]
    last = (k == after)[..., None]
    p1 = np.where(last, p0 + v0, reference.position_rad[after])
    v1 = np.where(last, v0, T * reference.velocity_rad_s[after])
    position, slope = hermite(p0, v0, p1, v1, x)
    return position, np.where(x == 0, v0, slope) / T


def sample(
    mechanism: Mechanism,
    trajectory: Trajectory,
    period_s: float,
    duration_s: float,
    limit: np.ndarray | None = None,
    *,
    begin_s: float = 0.0,
) -> SampledReference:
    """Return a trajectory at the control instants of a period [s] over a duration [s], from a time [s] on.

    A periodic trajectory is repeated. Any other one holds its last position at rest. More actuators than freedoms share its
    efforts as the trajectory does, within limits (n_u, 2) [N.m or N], by default the model's.
    """
    n = max(1, round(duration_s / period_s))
    ratio = trajectory.duration_s / period_s
    cycle = round(ratio) if trajectory.periodic and abs(ratio - round(ratio)) < 1e-6 else None
    # Samples of one cycle are computed once and repeated.
    once = np.arange(n if cycle is None else min(n, cycle))
    time, middle = begin_s + period_s * once, begin_s + period_s * (once + 0.5)
    if duration_s <= trajectory.duration_s:  # the middle of a last period that ends late is still in the motion
        middle = np.minimum(middle, trajectory.duration_s)
    position = trajectory.position_at(time)
    pose = follow(mechanism, position, trajectory.start_pose)
    pose_middle = follow(mechanism, trajectory.position_at(middle), trajectory.start_pose)
    rates, accelerations = trajectory.velocity_at(middle), trajectory.acceleration_at(middle)
    planned = trajectory.effort_at(middle)
    effort, _ = needed_effort(mechanism, pose_middle, rates, accelerations, middle, limit=limit, wanted=planned)
    again = np.arange(n) % len(once)
    passed = (np.arange(n) // len(once))[:, None] if cycle is not None else np.zeros((n, 1))
    gone = pose_advance(mechanism, trajectory) if np.any(passed) else np.zeros(mechanism.n_q)
    return SampledReference(
        period_s=period_s,
        time_s=period_s * np.arange(n),
        pose_rad=pose[again] + passed * gone,
        position_rad=position[again] + passed * trajectory.advance,
        velocity_rad_s=trajectory.velocity_at(time)[again],
        effort=effort[again],
        cycle=cycle,
        forces=mechanism.forces_at(begin_s + period_s * (np.arange(n) + 0.5)),
    )


def pose_advance(mechanism: Mechanism, trajectory: Trajectory) -> np.ndarray:
    """Return the advance (n_q,) [rad] of all joints over a period of a periodic motion: whole turns or zero."""
    if not np.any(trajectory.advance):
        return np.zeros(mechanism.n_q)
    time = trajectory.dense_times()
    poses = follow(mechanism, trajectory.position_at(time), trajectory.start_pose)
    return whole_turns(mechanism, poses[-1] - poses[0])
