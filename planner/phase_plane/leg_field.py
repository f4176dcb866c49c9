"""Accelerations of one degree of freedom under limits on effort, power, line, pin force, acceleration and speed.

Each limit bounds the effort at a given position and speed. A limit P on power bounds the effort by P / w, where w is the
actuator's speed. The torque-speed line of a motor bounds it by u = u_0 (1 - w / w_0), from stall effort to no-load speed.
The ctrlrange of a servo bounds it by lines, too: u = g c + b_0 + b_1 l + b_2 w at an end c, where l is the servo's length. A
pin force and the acceleration of a joint or site are affine in the effort. Their limit R bounds the effort by the roots of
|F(s, v, u)|^2 = R^2. Each limit states such a quantity itself (`Limit.affine`). Speed limits of
joints bound the speed v by the maximum velocity curve. Where the speed limit of a joint is active, the joint's speed r v is
constant, so v' = -r' v^2 / r. Here r is the joint's speed per unit of v.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from linkplan.models.poses.along import sampled
from linkplan.models.poses.assembly import follow
from linkplan.models.tree.friction import frictions_of
from linkplan.planner.limits.kinds import limits_of
from linkplan.planner.phase_plane.bang_bang_motions import Part
from linkplan.planner.problem.problem import Problem

# Numbers of the limits that an actuator is held at. 1 and -1 are the upper and lower limit of its effort, `AT_POWER` is its
# power and `AT_LINE` its motor's or servo's line. `AT_FORCE` is the first of n limits on affine quantities, such as a
# closure's force. The next n numbers belong to motions along the maximum velocity curve of the same limits, where one effort
# alone satisfies the limit. The numbers after these belong to joints with a limited speed. An affine quantity has a positive
# number where a larger effort reaches its limit, a negative one where a smaller effort does.
AT_POWER, AT_LINE, AT_FORCE = 2, 3, 4
# The share by which rounding may exceed limits on efforts, powers and forces.
_LIMIT_TOLERANCE = 1e-6
# Poses along a part of the way.
POSES_PER_PART = 2001


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class AffineBounds:
    """The limits along a part on quantities F = still + square v^2 + linear v + by_acceleration a + by_effort u.

    `curves` gives (5, n_rows) over the coordinate. `rows` are each quantity's rows, and `bounds` (n, 2) their limits: of the
    value of one row, or of the size of several.
    """

    curves: Callable[[Any], np.ndarray]
    rows: tuple[slice, ...]
    bounds: np.ndarray

    def efforts(self, s: Any, v: Any, a: np.ndarray, by: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the least and largest effort (..., n) that each limit allows, and by how much any effort overruns it.

        If no effort satisfies a limit, both efforts are the one of the least size, and the overrun is a share above zero.
        `a` (...) is the acceleration without effort, and `by` (...) is that of a unit of effort.
        """
        values, v = self.curves(s), np.asarray(v, dtype=float)[..., None]
        force = values[..., 0, :] + values[..., 1, :] * v**2 + values[..., 2, :] * v + values[..., 3, :] * a[..., None]
        acts = values[..., 3, :] * by[..., None] + values[..., 4, :]
        found = [_efforts_of(force[..., r], acts[..., r], *ends) for r, ends in zip(self.rows, self.bounds, strict=True)]
        least, most, over = (np.stack(of, axis=-1) for of in zip(*found, strict=True))
        return least, most, over

    def effort_unit(self, s: Any, k: int, by: np.ndarray) -> np.ndarray:
        """Return the effort (...) that changes quantity `k` by its limit, if `by` (...) is the acceleration of a unit."""
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
class ServoRanges:
    """The efforts at the ends of servos' ctrlranges, within their force clamps.

    `ends` (3, n_u, 2) are the coefficients of these efforts on 1, length and speed; efforts of other actuators are infinite.
    `lengths` gives the actuators' lengths (n_u,) over the coordinate, and `clamps` (n_u, 2) are force clamps [N.m or N].
    """

    lengths: Callable[[Any], np.ndarray]
    ends: np.ndarray
    clamps: np.ndarray

    def efforts(self, s: Any, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the least and largest effort (..., n_u) at positions (...) and actuator speeds (..., n_u)."""
        still, by_length, by_speed = self.ends
        found = still + by_length * self.lengths(s)[..., None] + by_speed * rate[..., None]
        return np.minimum(found[..., 0], self.clamps[:, 1]), np.maximum(found[..., 1], self.clamps[:, 0])

    def no_load_speed(self, s: Any) -> np.ndarray:
        """Return the largest actuator speed (..., n_u) at which an end of a range gives no effort; infinite without one."""
        still, by_length, by_speed = self.ends
        with np.errstate(divide="ignore", invalid="ignore"):
            speed = np.abs((still + by_length * self.lengths(s)[..., None]) / by_speed)
        return np.fmax(speed[..., 0], speed[..., 1])


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class VelocityCurve:
    """The maximum velocity curve along a part of the motion: the largest speed that satisfies all joints' speed limits.

    `curves(s, order)`  are the joints' speeds per unit of v (n,) at s, or their derivatives by s if `order`
    is 1. `speed` (n, 2) are the joints' speed limits [rad/s or m/s]. `way` is the direction, +1 or -1.
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
    """The efforts and accelerations that the limits on effort, power, line, speed and affine quantities allow along a part.

    M a = still + square v^2 + linear v + maps u - friction(s, v); `curves` gives (M, still, square, linear, maps...) over
    the coordinate. `effort` (n_u, 2) [N.m or N], `power` (n_u, 2) [W], `line` (n_u, 2) of stall efforts and no-load speeds,
    `way` +1 or -1. `affine` is None if no pin force or acceleration is limited, `velocity_curve` if no speed is, `servos` if
    no servo has a ctrlrange, and `friction` without dry friction.
    """

    curves: Callable[[Any], np.ndarray]
    effort: np.ndarray
    power: np.ndarray
    line: np.ndarray
    way: float
    affine: AffineBounds | None = None
    velocity_curve: VelocityCurve | None = None
    servos: ServoRanges | None = None
    friction: Callable[[Any, Any], np.ndarray] | None = None

    @property
    def at_speed(self) -> int:
        """The index of the first joint with a limited speed, among the limits at which an actuator can be held."""
        return AT_FORCE + (0 if self.affine is None else 2 * len(self.affine.rows))

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
        held = np.where(beyond, AT_FORCE + np.argmin(most, axis=-1)[..., None], held)
        held = np.where(short, -AT_FORCE - np.argmax(least, axis=-1)[..., None], held)
        return held, *self.along(s, v, held)

    def driven(self, s: Any, v: Any, *, towards: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the same as `at` for the limits on efforts, powers and lines only."""
        maps = self.curves(s)[..., 4:]
        upper = (maps * self.way > 0) == towards
        held, effort = np.where(upper, 1, -1), np.where(upper, self.effort[:, 1], self.effort[:, 0])
        spent = effort * maps * np.asarray(v)[..., None]
        held = np.where(spent > self.power[:, 1], AT_POWER, np.where(spent < self.power[:, 0], -AT_POWER, held))
        effort, a = self.along(s, v, held)
        low, high = self.line_efforts(s, maps * np.asarray(v)[..., None])
        lined = np.where(upper & (effort > high), AT_LINE, np.where(~upper & (effort < low), -AT_LINE, held))
        return (held, effort, a) if np.all(lined == held) else (lined, *self.along(s, v, lined))

    def room(self, s: Any, v: Any) -> np.ndarray:
        """Return the width (...) of the range of one actuator's efforts that satisfy all limits, as a share of its strength.

        Without such an effort it is negative.
        """
        ends = np.sort([self.driven(s, v, towards=towards)[1][..., 0] for towards in (False, True)], axis=0)
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
        rate, on_power = values[..., 4:] * v[..., None], np.abs(held) == AT_POWER
        upper = np.asarray(held) > 0
        power, limit = (np.where(upper, of[:, 1], of[:, 0]) for of in (self.power, self.effort))
        effort = np.where(on_power, power / np.where(on_power, rate, 1.0), limit)
        on_line = np.abs(held) == AT_LINE
        if np.any(on_line):
            low, high = self.line_efforts(s, rate)
            effort = np.where(on_line, np.where(upper, high, low), effort)
        if self.affine is not None and np.any(np.abs(held) >= AT_FORCE):
            least, most, _ = self._affine_efforts(s, v)
            for k in range(least.shape[-1]):
                effort = np.where(held == AT_FORCE + k, most[..., k, None], effort)
                effort = np.where(held == -AT_FORCE - k, least[..., k, None], effort)
                middle = 0.5 * (least[..., k, None] + most[..., k, None])
                effort = np.where(held == AT_FORCE + least.shape[-1] + k, middle, effort)
        return effort, (free + (values[..., 4:] * effort).sum(axis=-1)) / values[..., 0]

    def line_efforts(self, s: Any, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the least and largest effort (..., n_u) on the lines at positions (...) and actuator speeds (..., n_u)."""
        stall, no_load = self.line.T
        low, high = -stall * (1.0 + rate / no_load), stall * (1.0 - rate / no_load)
        if self.servos is None:
            return low, high
        least, most = self.servos.efforts(s, rate)
        return np.maximum(low, least), np.minimum(high, most)

    def no_load_speed(self, s: Any) -> np.ndarray:
        """Return the actuator speeds (..., n_u) at which the lines allow no effort; infinite without lines."""
        speed = np.broadcast_to(self.line[:, 1], (*np.shape(s), len(self.line)))
        return speed if self.servos is None else np.minimum(speed, self.servos.no_load_speed(s))

    @property
    def strength(self) -> np.ndarray:
        """The largest effort (n_u,) of each actuator at any position and speed."""
        return np.minimum(np.abs(self.effort).max(axis=1), self.line[:, 0])

    def at_end_of_room(self, s: Any, v: Any) -> np.ndarray:
        """Return the limits held (1,) by a motion along the end of the room of the affine quantity nearest to its limit."""
        over = self._affine_efforts(s, v)[2]
        return np.array([AT_FORCE + len(over) + int(np.argmax(over))])

    def limit_sizes(self, s: Any, held: np.ndarray) -> np.ndarray:
        """Return the efforts (..., n_u) that change the quantities at their limits by these limits, at most the strength."""
        if self.affine is None or not AT_FORCE <= abs(int(held[0])) < self.at_speed:
            return self.strength
        k = (abs(int(held[0])) - AT_FORCE) % len(self.affine.rows)
        values = self.curves(s)
        return np.minimum(self.strength, self.affine.effort_unit(s, k, values[..., 4] / values[..., 0])[..., None])

    def keeps(self, s: np.ndarray, v: np.ndarray, effort: np.ndarray) -> bool:
        """True if efforts (n, n_u) at positions and speeds (n,) satisfy all limits but those on speeds."""
        room = _LIMIT_TOLERANCE * np.abs(self.effort).max()
        rate = self.curves(s)[:, 4:] * v[:, None]
        least_of_line, most_of_line = self.line_efforts(s, rate)
        low, high = np.maximum(self.effort[:, 0], least_of_line), np.minimum(self.effort[:, 1], most_of_line)
        if self.affine is not None:
            least, most, over = self._affine_efforts(s, v)
            low, high = np.maximum(low, least.max(axis=-1)[:, None]), np.minimum(high, most.min(axis=-1)[:, None])
            if np.any(over > _LIMIT_TOLERANCE):
                return False
        spent = effort * rate
        powers = (spent <= (1 + _LIMIT_TOLERANCE) * self.power[:, 1]) & (spent >= (1 + _LIMIT_TOLERANCE) * self.power[:, 0])
        return bool(np.all((effort >= low - room) & (effort <= high + room)) and np.all(powers))


def lines_of(problem: Problem) -> np.ndarray:
    """Return the stall efforts and no-load speeds (n_u, 2) of the motors' lines, infinite without one."""
    lines = [None if motor is None else motor.line for motor in problem.motors]
    return np.array([(np.inf, np.inf) if line is None else line for line in lines])


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
    none = np.zeros((POSES_PER_PART, len(problem.limits.effort)))
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
    velocity_curve = None
    if problem.mechanism.n_u == 1 and np.isfinite(problem.limits.speed).any():
        limited = np.flatnonzero(np.isfinite(problem.limits.speed).any(axis=1))
        ratios = sampled(dynamics.velocity_map, q)[:, limited, 0]
        of_speeds = scipy.interpolate.CubicSpline(place[along], ratios[along])
        velocity_curve = VelocityCurve(curves=of_speeds, speed=problem.limits.speed[limited], way=way)
    lengths = np.nan_to_num(sampled(dynamics.actuator_length, q)[:, :, 0])  # unknown ones belong to no servo
    return LegField(
        curves=scipy.interpolate.CubicSpline(place[along], values[along]),
        effort=problem.limits.effort,
        power=problem.limits.power,
        line=lines_of(problem),
        way=way,
        affine=_affine(problem, place[along], q[along]),
        velocity_curve=velocity_curve,
        servos=_servos(problem, place[along], lengths[along]),
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
        at, speed = poses(np.ravel(s)), np.ravel(v)[:, None]
        motion = (at, speed, 0.0 * speed, np.zeros((len(at), problem.mechanism.n_u)))
        whole, without = (sampled(f, *motion)[:, 0, 0] for f in (dynamics.residual, dynamics.sliding))
        return (whole - without).reshape(np.shape(v))

    return friction


def _servos(problem: Problem, place: np.ndarray, lengths: np.ndarray) -> ServoRanges | None:
    """Return the ranges of the servos whose ctrlrange limits their efforts; None without one."""
    import scipy

    actuators = problem.mechanism.actuators
    ends = np.zeros((3, len(actuators), 2))
    ends[0] = -np.inf, np.inf
    for j, servo in enumerate(actuators):
        if servo.limits_control:
            ends[:, j] = np.array(servo.biases)[:, None]
            ends[0, j] += np.sort(servo.gain * np.array([servo.control_lower, servo.control_upper]))
    if not np.isfinite(ends[0]).any():
        return None
    clamps = np.array([(servo.lower, servo.upper) for servo in actuators])
    return ServoRanges(lengths=scipy.interpolate.CubicSpline(place, lengths), ends=ends, clamps=clamps)


def _affine(problem: Problem, place: np.ndarray, q: np.ndarray) -> AffineBounds | None:
    """Return the limits of one actuator on affine quantities, by splines of the poses (n, n_q); None without one."""
    import scipy

    known = [limit.affine(problem) for limit in limits_of(problem)] if problem.mechanism.n_u == 1 else []
    limited = [one for one in known if one is not None]
    if not limited:
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
    return AffineBounds(curves=curves, rows=tuple(rows), bounds=np.array([one.bounds for one in limited]))
