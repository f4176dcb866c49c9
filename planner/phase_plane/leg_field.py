"""Accelerations of one degree of freedom under limits on effort, power, line, pin force, acceleration and speed.

Each limit states itself how it bounds the motion. Limits of actuators bound the effort at a given position and speed
(`Limit.effort_bounds`). A pin force and the acceleration of a joint or site are affine in the effort (`Limit.affine`). Their
limit R bounds the effort by the roots of |F(s, v, u)|^2 = R^2. A quantity r v that is proportional to the speed v bounds it
by the maximum velocity curve. Where its limit is active, r v is constant, so v' = -r' v^2 / r.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from linkplan.models.poses.along import sampled
from linkplan.models.poses.assembly import follow
from linkplan.models.tree.friction import frictions_of
from linkplan.planner.limits.bounds import EffortBounds
from linkplan.planner.limits.kinds import affine_limits, all_effort_bounds
from linkplan.planner.phase_plane.bang_bang_motions import Part
from linkplan.planner.phase_plane.grid import speed_ratios
from linkplan.planner.problem.problem import Problem

# Each active limit has a number. The constant effort limit has 1, the further bounds of `LegField.bounds` follow, then the n
# limits on affine quantities. The number is negative if the effort is at its lower bound. The next n numbers are for motions
# along the maximum velocity curve of the affine quantities, where one effort alone satisfies the limit. The last numbers are
# for limits on speeds.
AT_EFFORT = 1
# The share by which rounding may exceed limits on efforts, powers and forces.
_LIMIT_TOLERANCE = 1e-6
# Poses along a part of the way.
POSES_PER_PART = 2001


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class AffineBounds:
    """The limits along a part on quantities F = still + square v^2 + linear v + by_acceleration a + by_effort u.

    `curves` gives (5, n_rows) over the coordinate. `rows` are each quantity's rows, and `bounds` (n, 2) their limits: of the
    value of one row, or of the size of several. `friction` gives what dry friction adds
    (..., n_rows) at positions and speeds.
    """

    curves: Callable[[Any], np.ndarray]
    rows: tuple[slice, ...]
    bounds: np.ndarray
    friction: Callable[[Any, Any], np.ndarray] | None = None

    def efforts(self, s: Any, v: Any, a: np.ndarray, by: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the least and largest effort (..., n) that each limit allows, and by how much any effort overruns it.

        If no effort satisfies a limit, both efforts are the one of the least size, and the overrun is a share above zero.
        `a` (...) is the acceleration without effort, and `by` (...) is that of a unit of effort.
        """
        values, v = self.curves(s), np.asarray(v, dtype=float)[..., None]
        force = values[..., 0, :] + values[..., 1, :] * v**2 + values[..., 2, :] * v + values[..., 3, :] * a[..., None]
        if self.friction is not None:
            force = force + self.friction(s, v[..., 0])
        acts = values[..., 3, :] * by[..., None] + values[..., 4, :]
        found = [_efforts_of(force[..., r], acts[..., r], *ends) for r, ends in zip(self.rows, self.bounds, strict=True)]
        least, most, over = (np.stack(of, axis=-1) for of in zip(*found, strict=True))
        return least, most, over

    def effort_unit(self, s: Any, k: int, by: np.ndarray) -> np.ndarray:
        """Return the effort (...) that changes quantity `k` by its limit, if a unit accelerates by `by` (...)."""
        values, r = self.curves(s), self.rows[k]
        acts = np.linalg.norm(values[..., 3, r] * by[..., None] + values[..., 4, r], axis=-1)
        return np.abs(self.bounds[k])[np.isfinite(self.bounds[k])].max() / np.maximum(acts, np.finfo(float).tiny)


def _efforts_of(given: np.ndarray, by: np.ndarray, low: float, high: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the roots u (...) of F = given + by u (..., n_rows) at its limits, in order, and the overrun as a share."""
    tiny = np.finfo(float).tiny
    if given.shape[-1] == 1:
        given, by = given[..., 0], np.where(np.abs(by[..., 0]) < tiny, tiny, by[..., 0])
        ends = np.sort([(low - given) / by, (high - given) / by], axis=0)
        return ends[0], ends[1], np.full(np.shape(given), -1.0)
    a, b, c = ((x * y).sum(axis=-1) for x, y in ((by, by), (by, given), (given, given)))
    a, c = np.maximum(a, tiny), c - high**2
    within = b * b - a * c
    root = np.sqrt(np.maximum(within, 0.0))
    return (-b - root) / a, (-b + root) / a, -within / (a * high**2)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class VelocityCurve:
    """The maximum velocity curve along a part of the motion: the largest speed that satisfies all limits on speeds.

    `curves(s, order)` are the limited quantities per unit of v (n,) at s, such as joints' speeds, or their derivatives by s
    if `order` is 1. `speed` (n, 2) are their limits. `way` is the direction, +1 or -1.
    """

    curves: Callable[..., np.ndarray]
    speed: np.ndarray
    way: float

    def shares(self, s: Any) -> np.ndarray:
        """Return each joint's speed (..., n) per unit of v, relative to its speed limit in that direction."""
        ratio = self.way * self.curves(s)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.fmax(ratio / np.where(ratio > 0, self.speed[:, 1], self.speed[:, 0]), 0.0)

    def at(self, s: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the largest speed (...) and the index (...) of the joint that is at its limit at this speed."""
        shares = self.shares(s)
        with np.errstate(divide="ignore"):
            return 1.0 / shares.max(axis=-1), np.argmax(shares, axis=-1)

    def acceleration(self, s: Any, v: Any, joint: Any) -> np.ndarray:
        """Return the acceleration (...) at which a joint's speed is constant; `joint` is one index, or one per position."""
        ratio, slope = (
            np.take_along_axis(self.curves(s, order), np.asarray(joint)[..., None], axis=-1)[..., 0] for order in (0, 1)
        )
        return -slope * np.square(v) / ratio


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class LegField:
    """The efforts and accelerations that the limits on efforts, affine quantities and speeds allow along a part.

    M a = still + square v^2 + linear v + maps u - friction(s, v); `curves` gives (M, still, square, linear, maps...) over
    the coordinate. The constant limits are the first of the `bounds` on efforts, which depend on actuators' speeds and on
    their `lengths` (n_u,) over the coordinate, if these are given. `way` is +1 or -1. `affine` is None if no pin force or
    acceleration is limited, `velocity_curve` if no speed is, and `friction` without dry friction.
    """

    curves: Callable[[Any], np.ndarray]
    bounds: tuple[EffortBounds, ...]
    way: float
    affine: AffineBounds | None = None
    velocity_curve: VelocityCurve | None = None
    lengths: Callable[[Any], np.ndarray] | None = None
    friction: Callable[[Any, Any], np.ndarray] | None = None

    @property
    def at_force(self) -> int:
        """The number of the first limit on an affine quantity (see `AT_EFFORT`)."""
        return AT_EFFORT + len(self.bounds)

    @property
    def at_speed(self) -> int:
        """The number of the first joint's speed limit (see `AT_EFFORT`)."""
        return self.at_force + (0 if self.affine is None else 2 * len(self.affine.rows))

    def at(self, s: Any, v: Any, *, towards: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the active limits (..., n_u) below the velocity curve, the efforts (..., n_u) and the acceleration.

        The efforts accelerate towards the end with all that the limits allow, or brake, at given positions and speeds.
        """
        held, effort, a = self.driven(s, v, towards=towards)
        if self.affine is None:
            return held, effort, a
        least, most, _ = self._affine_efforts(s, v)
        beyond = effort > most.min(axis=-1, keepdims=True)
        short = ~beyond & (effort < least.max(axis=-1, keepdims=True))
        held = np.where(beyond, self.at_force + np.argmin(most, axis=-1)[..., None], held)
        held = np.where(short, -self.at_force - np.argmax(least, axis=-1)[..., None], held)
        return held, *self.along(s, v, held)

    def driven(self, s: Any, v: Any, *, towards: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the same as `at` for the bounds on efforts only."""
        values, v = self.curves(s), np.asarray(v, dtype=float)
        maps = values[..., 4:]
        upper = (maps * self.way > 0) == towards
        least, most = self.bounded(s, maps * v[..., None])
        held = np.where(upper, AT_EFFORT + np.argmin(most, axis=0), -AT_EFFORT - np.argmax(least, axis=0))
        effort = np.where(upper, most.min(axis=0), least.max(axis=0))
        return held, effort, (self._free(s, v) + (maps * effort).sum(axis=-1)) / values[..., 0]

    def bounded(self, s: Any, rate: np.ndarray) -> np.ndarray:
        """Return the least and largest efforts (2, n_bounds, ..., n_u) at positions (...) and actuator speeds (..., n_u)."""
        length, found = None if self.lengths is None else self.lengths(s), np.empty((2, len(self.bounds), *rate.shape))
        for k, one in enumerate(self.bounds):
            found[0, k], found[1, k] = one.at(rate, length)
        return found

    def room(self, s: Any, v: Any) -> np.ndarray:
        """Return the width (...) of the range of one actuator's efforts that satisfy all limits, as a share of its strength.

        Without such an effort it is negative.
        """
        least, most = self.bounded(s, self.curves(s)[..., 4:] * np.asarray(v)[..., None])[..., 0]
        ends = np.sort([least.max(axis=0), most.min(axis=0)], axis=0)
        if self.affine is None:
            return (ends[1] - ends[0]) / self.strength[0]
        least, most, over = self._affine_efforts(s, v)
        room = np.minimum(ends[1], most.min(axis=-1)) - np.maximum(ends[0], least.max(axis=-1))
        worst = over.max(axis=-1)
        return np.where(worst > 0, -worst, room / self.strength[0])

    def _affine_efforts(self, s: Any, v: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the efforts and overruns (..., n) of `AffineBounds.efforts` at positions and speeds (...)."""
        assert self.affine is not None  # its callers have checked it
        values, v = self.curves(s), np.asarray(v, dtype=float)
        return self.affine.efforts(s, v, self._free(s, v) / values[..., 0], values[..., 4] / values[..., 0])

    def _free(self, s: Any, v: np.ndarray) -> np.ndarray:
        """Return M a (...) without efforts."""
        values = self.curves(s)
        free = values[..., 1] + values[..., 2] * v**2 + values[..., 3] * v
        return free if self.friction is None else free - self.friction(s, v)

    def along(self, s: Any, v: Any, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the efforts (..., n_u) of actuators held at limits, and the acceleration, at given positions and speeds."""
        values, v = self.curves(s), np.asarray(v, dtype=float)
        free = self._free(s, v)
        if self.velocity_curve is not None and np.all(held >= self.at_speed):
            a = self.velocity_curve.acceleration(s, v, np.broadcast_to(held[..., 0] - self.at_speed, v.shape))
            return ((values[..., 0] * a - free) / values[..., 4])[..., None], a
        held = np.asarray(held)
        least, most = self.bounded(s, values[..., 4:] * v[..., None])
        which = np.broadcast_to(np.minimum(np.abs(held), len(self.bounds)) - AT_EFFORT, least.shape[1:])[None]
        upper, lower = (np.take_along_axis(side, which, axis=0)[0] for side in (most, least))
        effort = np.where(held > 0, upper, lower)
        if self.affine is not None and np.any(np.abs(held) >= self.at_force):
            least, most, _ = self._affine_efforts(s, v)
            for k in range(least.shape[-1]):
                effort = np.where(held == self.at_force + k, most[..., k, None], effort)
                effort = np.where(held == -self.at_force - k, least[..., k, None], effort)
                middle = 0.5 * (least[..., k, None] + most[..., k, None])
                effort = np.where(held == self.at_force + least.shape[-1] + k, middle, effort)
        return effort, (free + (values[..., 4:] * effort).sum(axis=-1)) / values[..., 0]

    def no_load_speed(self, s: Any) -> np.ndarray:
        """Return the actuator speeds (..., n_u) at which the bounds allow no effort; infinite without such a speed."""
        length = None if self.lengths is None else self.lengths(s)
        speeds = [one.no_load_speed(length) for one in self.bounds if one.no_load_speed is not None]
        return functools.reduce(np.minimum, speeds, np.full((*np.shape(s), len(self.strength)), np.inf))

    @property
    def strength(self) -> np.ndarray:
        """The largest effort (n_u,) of each actuator at any position and speed."""
        return np.min([one.strength for one in self.bounds], axis=0)

    def at_end_of_room(self, s: Any, v: Any) -> np.ndarray:
        """Return the active limit (1,) on the maximum velocity curve: that of the affine quantity nearest to its limit."""
        over = self._affine_efforts(s, v)[2]
        return np.array([self.at_force + len(over) + int(np.argmax(over))])

    def limit_sizes(self, s: Any, held: np.ndarray, effort: np.ndarray) -> np.ndarray:
        """Return the sizes (..., n_u) of active limits (n_u,), relative to which errors of the effort (..., n_u) are judged.

        Along a limit on a line, pin force or acceleration the effort may be zero, so the size is that of the whole limit.
        """
        number = np.abs(held)
        if np.all(number < self.at_force) and not any(self.bounds[k - AT_EFFORT].crosses_zero for k in number):
            return np.abs(effort)
        if self.affine is None or not self.at_force <= number[0] < self.at_speed:
            return self.strength
        k = (abs(int(held[0])) - self.at_force) % len(self.affine.rows)
        values = self.curves(s)
        return np.minimum(self.strength, self.affine.effort_unit(s, k, values[..., 4] / values[..., 0])[..., None])

    def keeps(self, s: np.ndarray, v: np.ndarray, effort: np.ndarray) -> bool:
        """True if efforts (n, n_u) at positions and speeds (n,) satisfy all limits but those on speeds."""
        room = _LIMIT_TOLERANCE * self.bounds[0].strength.max()
        least, most = self.bounded(s, self.curves(s)[:, 4:] * v[:, None])
        for one, low, high in zip(self.bounds, least, most, strict=True):
            absolute = one.constant or one.crosses_zero
            allowed = [room if absolute else _LIMIT_TOLERANCE * np.abs(end) for end in (low, high)]
            if np.any((effort < low - allowed[0]) | (effort > high + allowed[1])):
                return False
        if self.affine is None:
            return True
        least, most, over = self._affine_efforts(s, v)
        low, high = least.max(axis=-1)[:, None], most.min(axis=-1)[:, None]
        return bool(np.all((effort >= low - room) & (effort <= high + room)) and np.all(over <= _LIMIT_TOLERANCE))


def field_along(problem: Problem, part: Part, start_pose: np.ndarray) -> LegField:
    """Return the field of accelerations that the problem's limits allow along a part.

    Raises:
        AssemblyError: if the loops cannot be closed at a position of the part.
    """
    import scipy

    dynamics, start, goal = problem.mechanism.dynamics, part.places[0], part.places[-1]
    place = np.linspace(start, goal, POSES_PER_PART)
    deadline, way_there = problem.solver.deadline, np.linspace(problem.motion.start[0], start, POSES_PER_PART)
    there = follow(problem.mechanism, way_there[:, None], start_pose, deadline)[-1]
    q = follow(problem.mechanism, place[:, None], there, deadline)
    inertia, maps = sampled(dynamics.reduced_inertia, q)[:, 0, 0], sampled(dynamics.effort_map, q)[:, 0]
    none = np.zeros((POSES_PER_PART, problem.mechanism.n_u))
    speeds = {v: np.full((POSES_PER_PART, 1), v) for v in (0.0, 1.0, -1.0)}
    accelerations = [sampled(dynamics.acceleration, q, v, none)[:, :, 0] for v in speeds.values()]
    still, fast, back = (inertia * a[:, 0] for a in accelerations)
    way = float(np.sign(goal - start))
    along = slice(None, None, int(way))
    friction = _friction(problem, place[along], q[along])
    square, linear = 0.5 * (fast + back) - still, 0.5 * (fast - back)
    if friction is not None:
        linear += friction(place, speeds[1.0][:, 0])
    values = np.column_stack([inertia, still, square, linear, maps])
    bounds, lengths = all_effort_bounds(problem), None
    if any(one.of_length for one in bounds):
        known = np.nan_to_num(sampled(dynamics.actuator_length, q)[:, :, 0])  # NaN: not a servo
        lengths = scipy.interpolate.CubicSpline(place[along], known[along])
    return LegField(
        curves=scipy.interpolate.CubicSpline(place[along], values[along]),
        bounds=bounds,
        way=way,
        affine=_affine(problem, place[along], q[along]),
        velocity_curve=_velocity_curve(problem, place[along], q[along], way),
        lengths=lengths,
        friction=friction,
    )


def _friction(problem: Problem, place: np.ndarray, q: np.ndarray) -> Callable[[Any, Any], np.ndarray] | None:
    """Return the dry friction (...) [N.m or N] at positions and speeds (...), by a spline of the poses (n, n_q), or None."""
    import scipy

    dynamics = problem.mechanism.dynamics
    if not any(frictions_of(problem.mechanism.model)):
        return None
    poses = scipy.interpolate.CubicSpline(place, q)

    def friction(s: Any, v: Any) -> np.ndarray:
        s, v = np.broadcast_arrays(s, v)
        at, speed = poses(np.ravel(s)), np.ravel(v)[:, None]
        motion = (at, speed, 0.0 * speed, np.zeros((len(at), problem.mechanism.n_u)))
        whole, without = (sampled(f, *motion)[:, 0, 0] for f in (dynamics.residual, dynamics.sliding))
        return (whole - without).reshape(np.shape(v))

    return friction


def _velocity_curve(problem: Problem, place: np.ndarray, q: np.ndarray, way: float) -> VelocityCurve | None:
    """Return the maximum velocity curve of limits on speeds, by splines of the poses (n, n_q); None without one."""
    import scipy

    ratios, bounds = speed_ratios(problem, q)
    if problem.mechanism.n_u > 1 or not len(bounds):
        return None
    return VelocityCurve(curves=scipy.interpolate.CubicSpline(place, ratios), speed=bounds, way=way)


def _affine(problem: Problem, place: np.ndarray, q: np.ndarray) -> AffineBounds | None:
    """Return the limits of one actuator on affine quantities, by splines of the poses (n, n_q); None without one."""
    import scipy

    limited = affine_limits(problem, of_speed=False)
    if problem.mechanism.n_u > 1 or not limited:
        return None
    none, ones, columns, rows = np.zeros((len(q), 1)), np.ones((len(q), 1)), [], []
    for one in limited:
        still, fast, back = (one.value(q, v, none, none) for v in (none, ones, -ones))
        by = [one.value(q, none, a, u) - still for a, u in ((ones, none), (none, ones))]
        own = np.stack([still, 0.5 * (fast + back) - still, 0.5 * (fast - back), *by], axis=1)
        begin = sum(column.shape[2] for column in columns)
        rows.append(slice(begin, begin + own.shape[2]))
        columns.append(own)
    curves = scipy.interpolate.CubicSpline(place, np.concatenate(columns, axis=2))
    poses = scipy.interpolate.CubicSpline(place, q)

    def friction(s: Any, v: Any) -> np.ndarray:
        s, v = np.broadcast_arrays(s, v)
        at, speed = poses(s.ravel()), v.reshape(-1, 1)
        still, square, linear, *_ = np.moveaxis(curves(s.ravel()), 1, 0)
        rubbed = np.hstack([one.value(at, speed, 0 * speed, 0 * speed) for one in limited])
        return (rubbed - still - square * speed**2 - linear * speed).reshape(*v.shape, -1)

    rubs = any(frictions_of(problem.mechanism.model))
    bounds = np.array([one.bounds for one in limited])
    return AffineBounds(curves=curves, rows=tuple(rows), bounds=bounds, friction=friction if rubs else None)
