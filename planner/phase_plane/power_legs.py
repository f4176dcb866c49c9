"""Least-time motions of one degree of freedom along limits on power and pin force: the phase plane's legs, over time.

For one degree of freedom each of these limits bounds the effort at a place and a speed: a power P bounds it by P / w, and a
pin force is affine in the effort, so that its rating R bounds it by the roots of |F(s, v, u)|^2 = R^2. A leg with all that
effort, power and pin forces allow from where a motion begins, another back from where it ends, and where they cross the
switch (Bobrow, Dubowsky & Gibson, Int. J. Robotics Research 4, 1985).

Along a power limit the effort falls off from a bang at rest that may last a hundred-thousandth of the motion, which
neither a grid over the way nor a mesh over time shows. Integrated, the legs say when each arc begins and ends, and what is
held along it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from linkplan.models.deadline import Deadline
from linkplan.models.errors import AssemblyError
from linkplan.models.poses.along import sampled, sliding_friction
from linkplan.models.poses.assembly import follow
from linkplan.planner.phase_plane.bang_bang_motions import Part, parts_of
from linkplan.planner.problem.problem import Problem

# What an actuator is held at: the limit of its effort (1 upper, -1 lower), of its power, or, from this number on, of the
# force of a closure, at the larger effort that reaches it (positive) or the smaller one (negative).
AT_POWER, AT_FORCE = 2, 3
# Efforts, powers and forces may exceed their limits by this share: rounding.
_LIMIT_TOLERANCE = 1e-6
# Poses along a part of the way.
_POSES_PER_PART = 2001
# The integration's relative tolerance, and its absolute one as a share of the way and of the largest speed: a bang arc from
# rest may end at a 30,000th of that.
_INTEGRATION_RTOL, _INTEGRATION_ATOL = 1e-10, 1e-14


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PinForces:
    """Forces of closures that are limited, along a part of the way: F = still + square v^2 + linear v + by_effort u.

    `curves` gives (4, n_rows) [N, ...] over the coordinate, divided by the closures' ratings; `rows` are those of each.
    """

    curves: Callable[[Any], np.ndarray]
    rows: tuple[slice, ...]

    def efforts(self, s: Any, v: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the least and largest efforts (..., n_closures) that each closure bears, and whether it bears any.

        If the closure bears no load, both are the effort of least force.
        """
        values, v = self.curves(s), np.asarray(v, dtype=float)[..., None]
        force = values[..., 0, :] + values[..., 1, :] * v**2 + values[..., 2, :] * v
        least, most, bears = [], [], []
        for rows in self.rows:
            given, by = force[..., rows], values[..., 3, rows]
            a, b, c = (by * by).sum(axis=-1), (by * given).sum(axis=-1), (given * given).sum(axis=-1) - 1.0
            a = np.maximum(a, np.finfo(float).tiny)
            within = b * b - a * c
            root = np.sqrt(np.maximum(within, 0.0))
            least.append((-b - root) / a)
            most.append((-b + root) / a)
            bears.append(within >= 0)
        return np.stack(least, axis=-1), np.stack(most, axis=-1), np.stack(bears, axis=-1)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class LegField:
    """All that effort, power and pin forces allow along a part of the way.

    M a = still + square v^2 + linear v + maps u; `curves` gives (M, still, square, linear, maps...) over the coordinate.
    `effort` (n_u, 2) [N.m or N], `power` (n_u, 2) [W], `way` +1 or -1; `pins` is None where no pin force is limited.
    """

    curves: Callable[[Any], np.ndarray]
    effort: np.ndarray
    power: np.ndarray
    way: float
    pins: PinForces | None = None

    def at(self, s: Any, v: Any, *, towards: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the limits (..., n_u) that hold, the efforts (..., n_u) and the acceleration at places and speeds.

        The efforts are those that push towards the end, or brake.
        """
        maps = self.curves(s)[..., 4:]
        upper = (maps * self.way > 0) == towards
        held, effort = np.where(upper, 1, -1), np.where(upper, self.effort[:, 1], self.effort[:, 0])
        spent = effort * maps * np.asarray(v)[..., None]
        held = np.where(spent > self.power[:, 1], AT_POWER, np.where(spent < self.power[:, 0], -AT_POWER, held))
        effort, a = self.along(s, v, held)
        if self.pins is None:
            return held, effort, a
        least, most, _ = self.pins.efforts(s, v)
        beyond = effort > most.min(axis=-1, keepdims=True)
        short = ~beyond & (effort < least.max(axis=-1, keepdims=True))
        held = np.where(beyond, AT_FORCE + np.argmin(most, axis=-1)[..., None], held)
        held = np.where(short, -AT_FORCE - np.argmax(least, axis=-1)[..., None], held)
        return held, *self.along(s, v, held)

    def along(self, s: Any, v: Any, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the efforts (..., n_u) of actuators that are held at limits, and the acceleration, at places and speeds."""
        values, v = self.curves(s), np.asarray(v, dtype=float)
        rate, on_power = values[..., 4:] * v[..., None], np.abs(held) == AT_POWER
        upper = np.asarray(held) > 0
        power, limit = (np.where(upper, of[:, 1], of[:, 0]) for of in (self.power, self.effort))
        effort = np.where(on_power, power / np.where(on_power, rate, 1.0), limit)
        if self.pins is not None and np.any(np.abs(held) >= AT_FORCE):
            least, most, _ = self.pins.efforts(s, v)
            for k in range(least.shape[-1]):
                effort = np.where(held == AT_FORCE + k, most[..., k, None], effort)
                effort = np.where(held == -AT_FORCE - k, least[..., k, None], effort)
        force = values[..., 1] + values[..., 2] * v**2 + values[..., 3] * v + (values[..., 4:] * effort).sum(axis=-1)
        return effort, force / values[..., 0]

    def keeps(self, s: np.ndarray, v: np.ndarray, *, towards: bool) -> bool:
        """True (n,) if an effort keeps all limits at a place and speed; without one no motion is that fast there."""
        if self.pins is None:
            return True
        _, effort, _ = self.at(s, v, towards=towards)
        least, most, bears = self.pins.efforts(s, v)
        room = _LIMIT_TOLERANCE * np.abs(self.effort).max()
        low, high = np.maximum(self.effort[:, 0], least.max(axis=-1)[:, None]), self.effort[:, 1]
        high = np.minimum(high, most.min(axis=-1)[:, None])
        spent = effort * self.curves(s)[:, 4:] * v[:, None]
        powers = (spent <= (1 + _LIMIT_TOLERANCE) * self.power[:, 1]) & (spent >= (1 + _LIMIT_TOLERANCE) * self.power[:, 0])
        return bool(np.all(bears) and np.all((effort >= low - room) & (effort <= high + room)) and np.all(powers))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Leg:
    """A leg over its own time (begin, end) [s]; `later` [s] is when its time is 0 in the motion."""

    field: LegField
    state: Callable[[Any], np.ndarray]  # (2,) or (2, n): place and speed
    steps: np.ndarray
    towards: bool
    begin: float
    end: float
    later: float = 0.0

    def time_at(self, place: float) -> float:
        """Return when it passes a place [s]."""
        import scipy

        return float(scipy.optimize.brentq(lambda t: self.state(t)[0] - place, self.begin, self.end, xtol=1e-15))

    def speed_at(self, place: float) -> float:
        """Return its speed at a place."""
        return float(self.state(self.time_at(place))[1])

    def held_at(self, t: float) -> tuple[int, ...]:
        """Return the limit held at an instant of its own time."""
        return tuple(int(one) for one in self.field.at(*self.state(t), towards=self.towards)[0])

    def is_possible(self) -> bool:
        """True if an effort keeps all limits at every examined instant."""
        return self.field.keeps(*self.state(self._looks()), towards=self.towards)

    def _looks(self) -> np.ndarray:
        """Return the instants (n,), in its own time, at which it is examined: four in each step of the integration."""
        knots = np.unique(np.clip(self.steps, self.begin, self.end))
        looks = np.interp(np.arange(4 * (len(knots) - 1) + 1) / 4, np.arange(len(knots)), knots)
        return 0.5 * (looks[1:] + looks[:-1])

    def arcs(self) -> list[tuple[float, tuple[int, ...]]]:
        """Return its arcs in order: the end of each [s], in the motion's time, and the limit held along it."""
        looks = self._looks()
        held, found = [self.held_at(t) for t in looks], []
        for k in range(1, len(looks)):
            if held[k] != held[k - 1]:
                before, after = looks[k - 1], looks[k]
                for _ in range(60):  # to rounding
                    middle = 0.5 * (before + after)
                    before, after = (middle, after) if self.held_at(middle) == held[k - 1] else (before, middle)
                found.append((self.later + after, held[k - 1]))
        return [*found, (self.later + self.end, held[-1])]


def knows_pins(problem: Problem) -> bool:
    """True if legs can keep the limits on pin forces: one degree of freedom, one actuator, no dry friction."""
    mechanism = problem.mechanism
    if not problem.limits.limited_closures or (mechanism.dof, mechanism.n_u) != (1, 1):
        return False
    return not sliding_friction(mechanism, mechanism.home[None]).any()


def power_legs(problem: Problem, start_pose: np.ndarray) -> tuple[list[Leg], np.ndarray] | None:
    """Return the legs of the quickest reach that never turns back but where it must, along limits on power and pin force.

    And when it passes start, waypoints and goal [s]; None without one, or if no power or force is at its limit.

    Args:
        problem: whose efforts are limited; of its other limits, all but those on power and pin force are left out.
        start_pose: closed (n_q,), at the start.
    """
    legs, boundaries = [], [0.0]
    try:
        for part in parts_of(problem.motion):
            pair = _legs(_field(problem, part, start_pose), part, boundaries[-1], problem.solver.deadline)
            if pair is None:
                return None
            legs += pair
            ahead, back = pair
            for place in part.places[1:-1]:
                leg = ahead if ahead.field.way * (ahead.state(ahead.end)[0] - place) > 0 else back
                boundaries.append(leg.later + leg.time_at(place))
            boundaries.append(back.later + back.end)
    except AssemblyError:  # the way is not open
        return None
    at_limits = any(np.any(np.abs(held) >= AT_POWER) for leg in legs for _, held in leg.arcs())
    return (legs, np.array(boundaries)) if at_limits else None


def _field(problem: Problem, part: Part, start_pose: np.ndarray) -> LegField:
    """Return the field of accelerations that effort, power and pin forces allow along a part.

    Raises:
        AssemblyError: where the way is not open.
    """
    import scipy

    dynamics, start, goal = problem.mechanism.dynamics, part.places[0], part.places[-1]
    place = np.linspace(start, goal, _POSES_PER_PART)
    deadline, way_there = problem.solver.deadline, np.linspace(problem.motion.start[0], start, _POSES_PER_PART)
    there = follow(problem.mechanism, way_there[:, None], start_pose, deadline)[-1]
    q = follow(problem.mechanism, place[:, None], there, deadline)
    inertia, maps = sampled(dynamics.reduced_inertia, q)[:, 0, 0], sampled(dynamics.effort_map, q)[:, 0]
    none = np.zeros((_POSES_PER_PART, len(problem.limits.effort)))
    speeds = {v: np.full((_POSES_PER_PART, 1), v) for v in (0.0, 1.0, -1.0)}
    accelerations = [sampled(dynamics.acceleration, q, v, none)[:, :, 0] for v in speeds.values()]
    still, fast, back = (inertia * a[:, 0] for a in accelerations)
    way, rub = float(np.sign(goal - start)), sliding_friction(problem.mechanism, q)
    square, linear = 0.5 * (fast + back) - still, 0.5 * (fast - back) + rub
    values = np.column_stack([inertia, still - way * rub, square, linear, maps])
    along = slice(None, None, int(way))
    pins = None
    if knows_pins(problem):
        still, fast, back = (
            sampled(dynamics.closure_force, q, v, a, none)[:, :, 0]
            for v, a in zip(speeds.values(), accelerations, strict=True)
        )
        pushed = sampled(dynamics.acceleration, q, speeds[0.0], none + 1.0)[:, :, 0]
        by_effort = sampled(dynamics.closure_force, q, speeds[0.0], pushed, none + 1.0)[:, :, 0] - still
        forces = np.stack([still, 0.5 * (fast + back) - still, 0.5 * (fast - back), by_effort], axis=1)
        pins = _pins(problem, place[along], forces[along])
    curves = scipy.interpolate.CubicSpline(place[along], values[along])
    return LegField(curves=curves, effort=problem.limits.effort, power=problem.limits.power, way=way, pins=pins)


def _pins(problem: Problem, place: np.ndarray, forces: np.ndarray) -> PinForces:
    """Return forces (n, 4, n_rows) [N, ...] of all closures at places (n,) as those of limited ones, by their ratings."""
    import scipy

    limited, columns, rows = problem.limits.limited_closures, [], []
    for c in limited:
        own = forces[:, :, problem.mechanism.closure_slice(c)] / problem.limits.closure_force[c]
        begin = sum(one.shape[2] for one in columns)
        rows.append(slice(begin, begin + own.shape[2]))
        columns.append(own)
    return PinForces(curves=scipy.interpolate.CubicSpline(place, np.concatenate(columns, axis=2)), rows=tuple(rows))


def _legs(field: LegField, part: Part, later: float, deadline: Deadline) -> list[Leg] | None:
    """Return the leg up to the switch and the one from there, the first begun `later` [s]; None where they do not meet."""
    import scipy

    start, goal, way = part.places[0], part.places[-1], field.way
    values = field.curves(np.linspace(start, goal, _POSES_PER_PART))
    span, force = abs(goal - start), np.abs(values[:, 1]) + np.abs(values[:, 4:]) @ np.abs(field.effort).max(axis=1)
    fastest = float(np.sqrt(2 * span * (force / values[:, 0]).max()))

    def leg(begin: float, v: float, end: float, *, towards: bool) -> Leg:
        def rates(_t: float, y: np.ndarray) -> list[float]:
            deadline.require_time()
            return [y[1], float(field.at(*y, towards=towards)[2])]

        def there(_t: float, y: np.ndarray) -> float:
            return y[0] - end

        def stalled(_t: float, y: np.ndarray) -> float:
            return way * y[1]

        there.terminal = stalled.terminal = True
        stalled.direction = -1.0
        until = 1e6 * span / fastest  # a million times what full effort takes
        found = scipy.integrate.solve_ivp(
            rates, (0.0, until if towards else -until), [begin, v], method="LSODA", events=(there, stalled),
            dense_output=True, rtol=_INTEGRATION_RTOL, atol=_INTEGRATION_ATOL * np.array([span, fastest]),
        )  # fmt: skip
        ends = np.sort([0.0, found.t[-1]])
        return Leg(field=field, state=found.sol, steps=np.sort(found.t), towards=towards, begin=ends[0], end=ends[1])

    ahead, back = leg(start, part.speeds[0], goal, towards=True), leg(goal, part.speeds[1], start, towards=False)
    beside = 1e-7 * span  # so near to the ends the legs are not distinct
    low = max(way * start, way * back.state(back.begin)[0]) + beside
    high = min(way * goal, way * ahead.state(ahead.end)[0]) - beside

    def apart(at: float) -> float:
        return way * (ahead.speed_at(way * at) - back.speed_at(way * at))

    if not low < high or not apart(low) < 0 < apart(high):
        return None
    switch = way * scipy.optimize.brentq(apart, low, high)
    one = replace(ahead, begin=0.0, end=ahead.time_at(switch), later=later)
    begin = back.time_at(switch)
    two = replace(back, begin=begin, end=0.0, later=later + one.end - begin)
    return [one, two] if one.is_possible() and two.is_possible() else None
