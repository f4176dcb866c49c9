"""Poses and dense samples of a motion, at which limits are measured."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from linkplan.models.actuation.distribution import UNLIMITED, distribute, missed_rounding
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import demanded, joint_rates, sampled
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.joint_forces import JointForces, closure_rows_along, joint_forces
from linkplan.planner.problem.instant import corner_demands_along, corner_efforts_along
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory

# Largest generalised effort that planned efforts may lack between nodes, as a share of the largest that they give: with a
# larger error they do not belong to the motion.
DYNAMICS_SHARE = 0.02
# Samples that are nearer, in shares of an interval, count as one: divided differences would be rounding errors.
_LEAST_DISTANCE = 1e-6
# Actuators are at a dead centre where their least transmission is below this share of its largest value along a motion. The
# effort by inverse dynamics divides by it: there no effort makes up for what the joints lack, which is judged itself.
DEAD_CENTRE_SHARE = 1e-2


@dataclass(frozen=True, eq=False, slots=True)
class Leverage:
    """Units (n_s, n_u) of Gamma^T B, zero for coordinates and actuators without effect, and the least transmission.

    Below the least transmission the actuators are at a dead centre. `given` is the largest generalised effort of actuators
    at their limits.
    """

    units: np.ndarray
    least: float
    given: float

    def transmission(self, maps: np.ndarray) -> np.ndarray:
        """Return the least singular value (n,) of maps (n, n_s, n_u) in these units."""
        rows, columns = np.flatnonzero(self.units.any(axis=1)), np.flatnonzero(self.units.any(axis=0))
        distinct = maps[:1] if np.all(maps == maps[:1]) else maps  # motors on the coordinates have the same everywhere
        scaled = (distinct * self.units)[:, rows[:, None], columns]
        least = np.linalg.svd(scaled, compute_uv=False)[:, -1] if scaled.size else np.ones(len(distinct))
        return np.broadcast_to(least, len(maps))


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
    def demanded(self) -> tuple[np.ndarray, np.ndarray]:
        """The generalised efforts (n_kinetics, n, n_s) that the motion needs, and Gamma^T B (n, n_s, n_u).

        In first-order schemes positions have accelerations of their own, which are the second kinetics.
        """
        motion, mechanism = self.trajectory, self.problem.mechanism
        tau, maps = demanded(mechanism, self.q, self.v, self.a, self.time)
        taus = [tau]
        if len(motion.position) == len(motion.velocity):
            taus.append(demanded(mechanism, self.q, motion.slope_at(self.time), motion.bend_at(self.time), self.time)[0])
        return np.stack(taus), maps

    @property
    def lacking(self) -> np.ndarray:
        """The generalised efforts (n_kinetics, n, n_s) that the planned efforts lack."""
        taus, maps = self.demanded
        return taus - np.einsum("ksu,ku->ks", maps, self.u)

    @cached_property
    def lacking_allowed(self) -> float:
        """The largest generalised effort that the planned efforts may lack."""
        given = np.einsum("ksu,ku->ks", self.demanded[1], self.u)
        return max(DYNAMICS_SHARE * float(np.abs(given).max()), self.lacking_rounding)

    @cached_property
    def lacking_rounding(self) -> float:
        """The generalised effort that is rounding: of efforts, and of the inertia's effort (measured: 1e-7).

        The latter counts without any effort, as for a crank that turns freely.
        """
        still, mechanism = np.zeros_like(self.a), self.problem.mechanism
        inertial = float(np.abs(self.demanded[0][0] - demanded(mechanism, self.q, self.v, still, self.time)[0]).max())
        return max(missed_rounding(self.problem.limits.effort), 1e-6 * inertial)

    @cached_property
    def leverage(self) -> Leverage:
        """The units of transmissions: efforts at their limits, and what these give at most along the motion."""
        limit, (_, maps) = self.problem.limits.effort, self.demanded
        effort = np.where(np.isfinite(limit), np.abs(limit), np.abs(self.u).max(axis=0)[:, None]).max(axis=1)
        effort = np.where(effort > 0, effort, 1.0) * maps.any(axis=(0, 1))
        given = (np.abs(maps) @ effort).max(axis=0)
        units = np.divide(effort, given[:, None], out=np.zeros(maps.shape[1:]), where=given[:, None] > 0)
        largest = float(given.max())
        return Leverage(units, DEAD_CENTRE_SHARE * float(Leverage(units, 0.0, largest).transmission(maps).max()), largest)

    @cached_property
    def at_dead_centre(self) -> np.ndarray:
        """True (n,) where the actuators are at a dead centre."""
        return self.leverage.transmission(self.demanded[1]) < self.leverage.least

    @cached_property
    def needed_efforts(self) -> np.ndarray:
        """The efforts (n_kinetics, n, n_u) by inverse dynamics.

        They are the planned efforts, and except at a dead centre the least efforts that give what these lack.
        """
        (taus, maps), apart = self.demanded, ~self.at_dead_centre
        found = np.stack([self.u] * len(taus))
        found[:, apart] = [distribute(tau[apart], maps[apart], UNLIMITED, self.u[apart]) for tau in taus]
        return found

    @cached_property
    def joint_rates(self) -> np.ndarray:
        """The rates (n, n_q) of all joints."""
        return joint_rates(self.problem.mechanism, self.q, self.v)

    @cached_property
    def closure_forces(self) -> np.ndarray:
        """The size (n, n_closures) [N] of every closure's force."""
        return closure_forces(self.problem, self.q, self.v, self.a, self.u, *self.forces)

    @cached_property
    def joint_forces(self) -> JointForces:
        """The forces and moments in all closures and pins of the tree, and on the frame."""
        return joint_forces(self.problem.mechanism, self.q, self.v, self.a, self.u, *self.forces)

    @cached_property
    def corner_efforts(self) -> np.ndarray:
        """The efforts (n, n_corners, n_u) of machines at the corners of the ranges in [robust].

        At a dead centre they are the planned efforts if these lack no more than `corner_allowed`.
        """
        mechanism, corners, motion = self.problem.mechanism, self.problem.robust.corners, (self.q, self.v, self.a)
        found = corner_efforts_along(mechanism, corners, *motion, self.u, *self.forces)
        at = np.flatnonzero(self.at_dead_centre)
        if not at.size:
            return found
        planned = np.einsum("ksu,ku->ks", self.demanded[1], self.u)
        lacking = corner_demands_along(mechanism, corners, *motion, *self.forces) - planned[:, None]
        given = self.at_dead_centre[:, None] & (np.abs(lacking).max(axis=2) <= self.corner_allowed)
        return np.where(given[:, :, None], self.u[:, None], found)

    @property
    def corner_allowed(self) -> float:
        """The largest generalised effort that planned efforts may lack for a machine of [robust] at a dead centre.

        It is a share of what actuators at their limits give at most, of which they give less than half there.
        """
        return DYNAMICS_SHARE * self.leverage.given


def samples_of(problem: Problem, trajectory: Trajectory, also: Sequence[float] = ()) -> Samples:
    """Return a motion's samples.

    Args:
        problem: of the motion.
        trajectory: the motion.
        also: shares of the duration, at which samples are also taken: at their place in an interval, in every interval.

    Raises:
        AssemblyError: when the loops cannot close along the motion.
        OutOfTimeError: when the certificate's deadline passes before its poses are known.
    """
    points, breaks_s = sample_points(trajectory.velocity.shape[0] - 1), trajectory.breaks_s
    asked = breaks_s[0] + np.asarray(also) * (breaks_s[-1] - breaks_s[0])
    interval = np.clip(np.searchsorted(breaks_s, asked, side="right") - 1, 0, len(breaks_s) - 2)
    for place in (asked - breaks_s[interval]) / np.diff(breaks_s)[interval]:
        if np.abs(points - place).min() > _LEAST_DISTANCE:
            points = np.sort(np.append(points, place))
    time = trajectory.times_at(points)
    until = problem.solver.judging_deadline
    q = follow(problem.mechanism, trajectory.position_at(time), trajectory.start_pose, until)
    return Samples(problem=problem, trajectory=trajectory, points=points, time=time, q=q)


@lru_cache(maxsize=2)
def samples_for_claims(problem: Problem, trajectory: Trajectory) -> Samples:
    """Return the samples whose allowances the claims of a proof share; the start alone if the loops open on the way."""
    try:
        return samples_of(problem, trajectory)
    except AssemblyError:
        start = {"points": np.zeros(1), "time": trajectory.breaks_s[:1], "q": trajectory.start_pose[None]}
        return Samples(problem=problem, trajectory=trajectory, **start)


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
    force = closure_rows_along(mechanism, q, v, a, u, *forces)
    sizes = [np.linalg.norm(force[:, mechanism.closure_slice(c)], axis=1) for c in range(len(mechanism.closure_names))]
    return np.array(sizes).T.reshape(len(q), -1)


def singularity_ratios(mechanism: Mechanism, q: np.ndarray) -> np.ndarray:
    """Return the least of J_z's block determinants at poses q (n, n_q), relative to home: 0 at a singular pose.

    Without loops it is 1.
    """
    if len(mechanism.dependent) == 0:
        return np.ones(len(q))
    block = mechanism.dynamics.block_singularity
    return (sampled(block, q)[:, :, 0] / np.array(block(mechanism.home)).ravel()).min(axis=1)
