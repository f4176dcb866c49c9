"""Poses and dense samples of a motion, at which limits are measured."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from linkplan.models.poses.along import joint_rates, sampled
from linkplan.models.poses.assembly import follow
from linkplan.planner.problem.instant import corner_efforts_along
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory


@dataclass(frozen=True, eq=False, kw_only=True)
class Poses:
    """Closed poses `q` (n, n_q) of a problem's mechanism."""

    problem: Problem
    q: np.ndarray

    def of_pose(self, name: str) -> np.ndarray:
        """Return a column (n, rows) of the reduced dynamics that depends on the pose only."""
        return sampled(getattr(self.problem.mechanism.dynamics, name), self.q)[:, :, 0]

    def coefficients(self, name: str, joint: int) -> np.ndarray | None:
        """Return the Bernstein coefficients (n_nodes, n_intervals) of a joint's position or velocity, if they are known."""
        del name, joint  # known for motions only

    @cached_property
    def block_ratios(self) -> np.ndarray:
        """The determinants (n, n_blocks) of J_z's blocks (loops that close together), relative to home."""
        at_home = np.array(self.problem.mechanism.dynamics.block_singularity(self.problem.mechanism.home)).ravel()
        return self.of_pose("block_singularity") / at_home


@dataclass(frozen=True, eq=False, kw_only=True)
class Samples(Poses):
    """A motion of a problem at `time` (n,) [s], at the shares `points` of every interval.

    Poses `q` (n, n_q), independent speeds and accelerations `v`, `a` (n, n_s), efforts `u` (n, n_u). Everything else is
    computed when it is first used.
    """

    trajectory: Trajectory
    points: np.ndarray
    time: np.ndarray
    v: np.ndarray = field(init=False)
    a: np.ndarray = field(init=False)
    u: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        motion = self.trajectory
        for name, of in (("v", motion.velocity_at), ("a", motion.acceleration_at), ("u", motion.effort_at)):
            object.__setattr__(self, name, of(self.time))

    def coefficients(self, name: str, joint: int) -> np.ndarray | None:
        """Return the Bernstein coefficients (n_nodes, n_intervals) of an independent joint's position or velocity."""
        columns = np.flatnonzero(self.problem.mechanism.independent == joint)
        return getattr(self.trajectory, name)[:, :, columns[0]] if len(columns) else None

    @cached_property
    def forces(self) -> tuple[np.ndarray, ...]:
        """The forces over time of `Mechanism.forces_at`."""
        return self.problem.mechanism.forces_at(self.time)

    @cached_property
    def jerk(self) -> np.ndarray:
        """The independent joints' jerk (n, n_s) within the intervals."""
        return self.trajectory.jerk_at(self.time)

    @cached_property
    def acceleration_jumps(self) -> np.ndarray:
        """The jumps of acceleration (n, n_s), each at the first sample after it or at the motion's last; otherwise zero."""
        motion, jumps, found = self.trajectory, self.trajectory.acceleration_jumps(), np.zeros(self.v.shape)
        interval, first = np.unique(np.searchsorted(motion.breaks_s[1:-1], self.time, side="right"), return_index=True)
        found[first] = jumps[interval]
        found[-1] += jumps[-1]
        return found

    @property
    def motion(self) -> tuple[np.ndarray, ...]:
        """The independent joints' speeds and accelerations, efforts, jerk, and forces over time."""
        return (self.v, self.a, self.u, self.jerk, *self.forces)

    @cached_property
    def actuator_speeds(self) -> np.ndarray:
        """The actuators' speeds (n, n_u) [rad/s or m/s]."""
        return actuator_speeds(self.problem, self.q, self.v)

    @cached_property
    def joint_rates(self) -> np.ndarray:
        """The rates (n, n_q) of all joints."""
        return joint_rates(self.problem.mechanism, self.q, self.v)

    @cached_property
    def closure_forces(self) -> np.ndarray:
        """The size (n, n_closures) [N] of every closure's force."""
        return closure_forces(self.problem, self.q, self.v, self.a, self.u, *self.forces)

    @cached_property
    def corner_efforts(self) -> np.ndarray:
        """The efforts (n, n_corners, n_u) of machines at the corners of the ranges in [robust]."""
        problem = self.problem
        motion = (self.q, self.v, self.a, self.u, *self.forces)
        return corner_efforts_along(problem.mechanism, problem.robust.corners, *motion)


def samples_of(problem: Problem, trajectory: Trajectory) -> Samples:
    """Return a motion's samples.

    Raises:
        AssemblyError: when the loops cannot close along the motion.
        OutOfTimeError: when the certificate's deadline passes before its poses are known.
    """
    points = sample_points(trajectory.velocity.shape[0] - 1)
    time = trajectory.times_at(points)
    until = problem.solver.judging_deadline
    q = follow(problem.mechanism, trajectory.position_at(time), trajectory.start_pose, until)
    return Samples(problem=problem, trajectory=trajectory, points=points, time=time, q=q)


def sample_points(n_nodes: int) -> np.ndarray:
    """Return the shares (n,) of an interval at which motions with so many nodes are sampled, denser at its ends.

    The nodes of high degrees are also dense there.
    """
    n = max(12, 3 * n_nodes)  # three for each node, and as many as parabolas through them need
    points = 0.5 - 0.5 * np.cos(np.pi * np.arange(n + 1) / n)
    points[-1] = 1.0 - 1e-12  # the end that still belongs to this interval
    return points


def least_between(values: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the least value (n,) of a smooth curve on each interval: a sample, or a minimum between samples.

    If a parabola through three samples has its vertex among them, the minimum is that of the polynomial through the seven
    samples around them. The parabola alone had errors of 1e-8 of a speed.

    Args:
        values: samples (n, n_points), or all in one row.
        points: their shares (n_points,) of an interval.
    """
    rows = values.reshape(-1, len(points))
    least = rows.min(axis=1)
    with np.errstate(all="ignore"):  # with infinite values, the least sample is used
        slope = np.diff(rows, axis=1) / np.diff(points)
        bend = np.diff(slope, axis=1) / (points[2:] - points[:-2])
        at = slope[:, :-1] + bend * (points[1:-1] - points[:-2])
        vertex = points[1:-1] - at / (2 * bend)
        inside = (bend > 0) & (vertex >= points[:-2]) & (vertex <= points[2:]) & np.isfinite(rows).all(axis=1)[:, None]
    row, first = np.nonzero(inside)
    np.minimum.at(least, row, _minimum_near(rows[row], points, first, vertex[row, first]))
    return least


def _minimum_near(rows: np.ndarray, points: np.ndarray, first: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """Return the minima (m,) of curves with samples (m, n_points) between three of them, of which `first` (m,) is the first.

    Three steps of Newton's method find them from a guess (m,) on Newton's interpolation polynomial through seven samples.
    """
    n = min(7, len(points))
    columns = np.clip(first - (n - 3) // 2, 0, len(points) - n)[:, None] + np.arange(n)
    x, differences = points[columns], np.take_along_axis(rows, columns, axis=1)
    for order in range(1, n):  # divided differences
        differences[:, order:] = np.diff(differences[:, order - 1 :], axis=1) / (x[:, order:] - x[:, :-order])
    low, high, at = points[first], points[first + 2], guess
    for _ in range(4):
        value, rate, bend = differences[:, -1], np.zeros_like(at), np.zeros_like(at)
        for k in range(n - 2, -1, -1):
            off = at - x[:, k]
            value, rate, bend = differences[:, k] + off * value, value + off * rate, 2 * rate + off * bend
        at = np.clip(at - rate / np.where(bend > 0, bend, np.inf), low, high)
    return value


def actuator_speeds(problem: Problem, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the actuators' speeds (n, n_u) [rad/s or m/s], (Gamma^T B)^T v, at poses q (n, n_q)."""
    return np.einsum("ksu,ks->ku", sampled(problem.mechanism.dynamics.effort_map, q), v)


def closure_forces(problem: Problem, q, v, a, u, *forces: np.ndarray) -> np.ndarray:
    """Return the size (n, n_closures) [N] of every closure's force; `forces` are those of `Mechanism.forces_at`."""
    mechanism = problem.mechanism
    force = sampled(mechanism.forced.closure_force, q, v, a, u, *forces)[:, :, 0]
    sizes = [np.linalg.norm(force[:, mechanism.closure_slice(c)], axis=1) for c in range(len(mechanism.closure_names))]
    return np.array(sizes).T.reshape(len(q), -1)


def singularity_ratios(problem: Problem, q: np.ndarray) -> np.ndarray:
    """Return the least of J_z's block determinants at poses q (n, n_q), relative to home: 0 at a singular pose.

    Without loops it is 1.
    """
    if len(problem.mechanism.dependent) == 0:
        return np.ones(len(q))
    return Poses(problem=problem, q=q).block_ratios.min(axis=1)
