"""Least-time motions of one degree of freedom as legs along limits on power, line, pin force, acceleration and speed.

One leg accelerates from the start with all the effort that the limits allow. Another leg brakes into the goal. They cross
at the switch (Bobrow, Dubowsky & Gibson, Int. J. Robotics Research 4, 1985). Limits on speeds, and those that
no effort satisfies at high speeds, add the maximum velocity curve. Where this curve falls and the motion can brake as fast,
the legs into the goal follow it. Where the curve rises faster than the motion can accelerate, a leg from the start leaves it
and later meets a leg into the goal.

Under a power limit, the motion from rest begins with a bang arc, after which the effort decreases. This bang arc may last
a hundred-thousandth of the motion, which neither a grid over position nor a mesh over time resolves. The integrated legs
give the end of each arc and the limit along it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from linkplan.models.deadline import Deadline
from linkplan.models.errors import AssemblyError
from linkplan.planner.phase_plane.bang_bang_motions import Part, parts_of
from linkplan.planner.phase_plane.leg_field import AT_EFFORT, POSES_PER_PART, LegField, field_along
from linkplan.planner.phase_plane.maximum_velocity import MaximumVelocity
from linkplan.planner.problem.problem import Problem

# The integration's relative tolerance, and its absolute one as a share of the way and of the largest speed: a bang arc from
# rest may end at a 30,000th of that.
_INTEGRATION_RTOL, _INTEGRATION_ATOL = 1e-12, 1e-14
# Speeds that differ by at most this share are the same.
_SAME_SPEED = 1e-9
# Marks a part of the velocity curve that no motion can follow, with one effort alone that satisfies all limits.
NO_ROOM = np.zeros(1, dtype=int)
# A leg leaves the velocity curve by a first step over this share of the span, which changes its energy by this share.
_LAUNCH_STEP, _LAUNCH_ENERGY = 1e-6, 1e-3
# The integration of a leg stops where the range of efforts within all limits is empty by this share of the strength.
_ROOM_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Leg:
    """A leg over its own time (begin, end) [s]; its time 0 is the instant `later` [s] of the motion.

    `held` (n_u,) is the active limit along the whole leg; None if the field determines it.
    """

    field: LegField
    state: Callable[[Any], np.ndarray]  # (2,) or (2, n): place and speed
    steps: np.ndarray
    towards: bool
    begin: float
    end: float
    later: float = 0.0
    held: np.ndarray | None = None

    def time_at(self, place: float) -> float:
        """Return the time [s] at which the leg passes a position."""
        import scipy

        way = self.field.way
        ahead = [way * (place - self.state(t)[0]) for t in (self.begin, self.end)]
        if ahead[0] <= 0 or ahead[1] >= 0:  # rounding, at its ends
            return self.begin if ahead[0] <= 0 else self.end
        return float(scipy.optimize.brentq(lambda t: self.state(t)[0] - place, self.begin, self.end, xtol=1e-15))

    def speed_at(self, place: float) -> float:
        """Return the leg's speed at a position."""
        return float(self.state(self.time_at(place))[1])

    def held_at(self, t: float) -> tuple[int, ...]:
        """Return the codes (n_u,) of the active limits at a time [s] on the leg's clock, as of `held`."""
        held = self.field.at(*self.state(t), towards=self.towards)[0] if self.held is None else self.held
        return tuple(int(one) for one in held)

    def is_possible(self) -> bool:
        """True if at every examined instant an effort satisfies all limits."""
        s, v = self.state(self._looks())
        field, held = self.field, self.held
        if held is NO_ROOM:
            return False
        effort = field.at(s, v, towards=self.towards)[1] if held is None else field.along(s, v, held)[0]
        return field.keeps(s, v, effort)

    def _looks(self) -> np.ndarray:
        """Return the instants (n,) at which the leg is examined, in its own time: four in each step of the integration."""
        knots = np.unique(np.clip(self.steps, self.begin, self.end))
        looks = np.interp(np.arange(4 * (len(knots) - 1) + 1) / 4, np.arange(len(knots)), knots)
        return 0.5 * (looks[1:] + looks[:-1])

    def arcs(self) -> list[tuple[float, tuple[int, ...]]]:
        """Return the leg's arcs in order: the end [s] of each arc, in the motion's time, and the active limit."""
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


def power_legs(problem: Problem, start_pose: np.ndarray) -> tuple[list[Leg], np.ndarray] | None:
    """Return the legs of the quickest reach along its limits that turns back only at required waypoints.

    The times [s] of start, waypoints and goal are returned too. The result is None without such a reach, or if only effort
    limits are active.

    Args:
        problem: one with limits on all efforts. Limits on power, line, pin force and speed are considered, others are not.
        start_pose: the closed pose (n_q,) at the start.
    """
    legs, boundaries = [], [0.0]
    try:
        for part in parts_of(problem.motion):
            field = field_along(problem, part, start_pose)
            of_part = _Way(field=field, part=part, deadline=problem.solver.deadline).legs()
            if of_part is None:
                return None
            for leg in of_part:
                legs.append(replace(leg, later=(legs[-1].later + legs[-1].end if legs else 0.0) - leg.begin))
            for place in part.places[1:-1]:
                passing = _leg_at(legs[-len(of_part) :], place)
                boundaries.append(passing.later + passing.time_at(place))
            boundaries.append(legs[-1].later + legs[-1].end)
    except AssemblyError:  # the loops open on the way
        return None
    at_limits = any(np.any(np.abs(held) > AT_EFFORT) for leg in legs for _, held in leg.arcs())
    return (legs, np.array(boundaries)) if at_limits else None


def _leg_at(legs: list[Leg], place: float) -> Leg:
    """Return the leg, of consecutive legs, that passes a position."""
    way = legs[0].field.way
    return next((leg for leg in legs if way * (leg.state(leg.end)[0] - place) > 0), legs[-1])


@dataclass(frozen=True, eq=False, kw_only=True)
class _Way:
    """A part of the motion, along which legs are integrated."""

    field: LegField
    part: Part
    deadline: Deadline

    @cached_property
    def places(self) -> np.ndarray:
        """Positions (n,) from start to goal at which the velocity curve is examined."""
        return np.linspace(self.part.places[0], self.part.places[-1], POSES_PER_PART)

    @cached_property
    def span(self) -> float:
        """The distance from start to goal."""
        return abs(self.part.places[-1] - self.part.places[0])

    @cached_property
    def beside(self) -> float:
        """The distance below which positions count as equal, much shorter than that over which the motion accelerates."""
        share = min(1.0, self.top_speed / self.fastest)
        return max(1e-7 * self.span * share**2, 4 * np.finfo(float).eps * float(np.abs(self.places).max()))

    @cached_property
    def fastest(self) -> float:
        """The speed that all efforts together would reach from start to goal."""
        values, effort = self.field.curves(self.places), self.field.bounds[0].strength
        force = np.abs(values[:, 1]) + np.abs(values[:, 4:]) @ effort
        return float(np.sqrt(2 * self.span * (force / values[:, 0]).max()))

    @cached_property
    def curve(self) -> MaximumVelocity:
        """The maximum velocity curve."""
        most = 10 * (self.fastest + max(abs(v) for v in self.part.speeds))
        return MaximumVelocity(field=self.field, span=self.span, most=most)

    @cached_property
    def top_speed(self) -> float:
        """The largest speed that limits on speeds and the lines allow at any position; infinite without them."""
        with np.errstate(divide="ignore"):
            no_load = np.abs(self.field.no_load_speed(self.places) / self.field.curves(self.places)[:, 4:])
        return float(np.minimum(self._fastest_at(self.places), no_load.min(axis=1)).max())

    def legs(self) -> list[Leg] | None:
        """Return the legs of the quickest motion from start to goal; None if they do not meet."""
        back = self._back()
        found = None if back is None else self._ahead(back)
        return found if found is not None and all(leg.is_possible() for leg in found) else None

    def _leg(self, begin: float, v: float, end: float, *, towards: bool, held: np.ndarray | None = None) -> Leg:
        """Return the leg from a position and speed to another position, or until it stalls: forward or backward in time."""
        import scipy

        field, way = self.field, self.field.way

        def rates(_t: float, y: np.ndarray) -> list[float]:
            self.deadline.require_time()
            s, v = y
            a = field.at(s, v, towards=towards)[2] if held is None else field.along(s, v, held)[1]
            return [v, float(a)]

        def there(_t: float, y: np.ndarray) -> float:
            return y[0] - end

        def stalled(_t: float, y: np.ndarray) -> float:
            return way * y[1]

        def roomy(_t: float, y: np.ndarray) -> float:
            return float(field.room(*y)) + _ROOM_TOLERANCE

        events = [there, stalled] if field.affine is None or held is not None else [there, stalled, roomy]
        for event in events:
            event.terminal = True
        stalled.direction = roomy.direction = -1.0
        first, v_first, taken = (begin, v, 0.0) if held is not None else self._launched(begin, v, towards=towards)
        until = 1e9 * self.span / self.fastest  # longer than any leg lasts
        atol, method = _INTEGRATION_ATOL * np.array([self.span, self.fastest]), "BDF" if taken else "LSODA"
        found = scipy.integrate.solve_ivp(
            rates, (taken, until if towards else -until), [first, v_first], method=method, events=events,
            dense_output=True, rtol=_INTEGRATION_RTOL, atol=atol,
        )  # fmt: skip

        def state(t: Any) -> np.ndarray:
            a, late = (v_first - v) / (taken or 1.0), found.sol(t)
            return np.where(np.abs(t) < abs(taken), [begin + v * t + 0.5 * a * np.square(t), v + a * t], late)

        steps = np.unique([0.0, *found.t])
        return Leg(field=field, state=state, steps=steps, towards=towards, begin=steps[0], end=steps[-1], held=held)

    def _launched(self, place: float, v: float, *, towards: bool) -> tuple[float, float, float]:
        """Return place, speed and time at which the integration of a leg begins, after one short implicit Euler step.

        The step leaves the velocity curve where one effort alone satisfies all limits. There the leg's acceleration may be
        0 / 0, or its slope infinite. Legs in both directions are stable, so the step's error decreases along them. They stay
        so close below the curve that they are stiff, and LSODA's steps do not grow again at this tolerance.
        """
        import scipy

        field, way = self.field, self.field.way
        top, joint = self.curve.at(place)
        if not v or joint >= 0 or way * v < (1 - _SAME_SPEED) * top or not np.isfinite(top):
            return place, v, 0.0
        strong = max(abs(float(field.driven(place, v, towards=ahead)[2])) for ahead in (True, False))
        step = min(_LAUNCH_STEP * self.span, _LAUNCH_ENERGY * v**2 / strong)
        first = place + step * (way if towards else -way)

        def missed(energy: float) -> float:
            return (
                energy - 0.5 * v**2 - (first - place) * float(field.at(first, way * np.sqrt(2 * energy), towards=towards)[2])
            )

        room = 2 * step * strong
        energy = scipy.optimize.brentq(missed, 0.5 * v**2 - room, 0.5 * v**2 + room, xtol=1e-300, rtol=1e-15)
        v_first = way * np.sqrt(2 * energy)
        return first, v_first, 2 * (first - place) / (v + v_first)

    def _fastest_at(self, place: Any) -> np.ndarray:
        """Return the maximum velocity curve (...) at positions; infinite where no limit bounds the speed."""
        return self.curve.at(place)[0]

    def _back(self) -> list[Leg] | None:
        """Return the legs, in order, of the fastest motion that arrives at the goal; None if it does not reach the start.

        Seen backward from the goal, the motion brakes fully below the velocity curve, and follows the curve where it can.
        """
        way, start, place, v = self.field.way, self.part.places[0], self.part.places[-1], self.part.speeds[1]
        found: list[Leg] = []
        follows = False
        while way * (place - start) > self.beside:
            top = self._fastest_at(place)
            if way * v > (1 + _SAME_SPEED) * top:
                return None
            follows = not follows and way * v > (1 - _SAME_SPEED) * top and self.curve.excess(place, towards=False) >= 0
            if follows:
                before = self.places[way * (self.places - place) < 0][::-1]
                first = self.curve.sign_change(np.concatenate([[place], before]), towards=False, sign=-1.0)
                found += reversed(list(self._curve_legs(first, place)))
                place, v = first, way * float(self._fastest_at(first))
                continue
            brake = self._leg(place, v, start, towards=False)
            begin = self._first_above(brake, self._fastest_at)
            if begin is None:  # the leg begins at the start, or stalls
                return [brake, *reversed(found)] if way * (brake.state(brake.begin)[0] - start) <= self.beside else None
            if abs(brake.state(begin)[0] - place) <= self.beside:  # rounding: it is neither below the curve nor along it
                return None
            found.append(replace(brake, begin=begin))
            place, v = brake.state(begin)
        return found[::-1]

    def _first_above(self, leg: Leg, top: Callable[[Any], np.ndarray]) -> float | None:
        """Return the first instant, in a leg's own time, at which the leg is faster than `top`; None if there is none."""
        import scipy

        way, t = self.field.way, np.linspace(leg.begin, leg.end, POSES_PER_PART)[:: 1 if leg.towards else -1]
        s, v = leg.state(t)
        # A leg may touch the velocity curve without crossing it.
        share = 1.0 if self.field.affine is None else 1.0 - 0.25 * _SAME_SPEED
        most = top(s)
        leaving = np.cumprod(np.abs(way * v - most) < _SAME_SPEED * most)  # a leg that begins on the curve leaves it slowly
        above = (way * v > share * most) & (np.abs(s - s[0]) > self.beside) & (leaving == 0)
        if not above.any():
            return None

        def apart(at: float) -> float:
            place, speed = leg.state(at)
            return float(way * speed - share * top(place))

        k = int(np.argmax(above))
        while apart(t[k]) <= 0 and k + 1 < len(t):  # `top` is less exact for many places than for one
            k += 1
        if apart(t[k]) < 0:
            return None
        return float(scipy.optimize.brentq(apart, t[k - 1], t[k], xtol=1e-15)) if apart(t[k - 1]) < 0 else float(t[k - 1])

    def _curve_legs(self, first: float, last: float) -> Iterator[Leg]:
        """Yield the legs along the velocity curve between two positions, one for each limit that determines it in turn."""
        way = self.field.way
        inside = self.places[(way * (self.places - first) > 0) & (way * (last - self.places) > 0)]
        places = np.concatenate([[first], inside, [last]])
        joints, edges = self.curve.at(places)[1], [first]
        for k in np.flatnonzero(joints[1:] != joints[:-1]):
            before, after = places[k], places[k + 1]
            for _ in range(50):  # to rounding
                middle = 0.5 * (before + after)
                before, after = (middle, after) if self.curve.at(middle)[1] == joints[k] else (before, middle)
            edges.append(float(after))
        for begin, end in zip(edges, [*edges[1:], last], strict=True):
            joint = int(self.curve.at(0.5 * (begin + end))[1])
            if abs(end - begin) > self.beside and joint >= 0:
                held = np.array([self.field.at_speed + joint])
                yield self._leg(begin, way * float(self._fastest_at(begin)), end, towards=True, held=held)
            elif abs(end - begin) > self.beside:
                followed = not self.curve.excess(np.linspace(begin, end, 13)[1:-1], towards=True).any()
                v = way * float(self._fastest_at(begin))
                held = self.field.at_end_of_room(begin, v) if followed else NO_ROOM
                yield self._leg(begin, v, end, towards=True, held=held) if followed else self._bound(begin, end)

    def _bound(self, begin: float, end: float) -> Leg:
        """Return the velocity curve between two positions as a leg that no motion follows; its time is its position."""
        way = self.field.way

        def state(t: Any) -> np.ndarray:
            place = way * np.asarray(t)
            return np.stack([place, way * self._fastest_at(place)])

        ends = way * np.array([begin, end])
        return Leg(field=self.field, state=state, steps=ends, towards=True, begin=ends[0], end=ends[1], held=NO_ROOM)

    def _ahead(self, back: list[Leg]) -> list[Leg] | None:
        """Return the legs at full acceleration until they cross the legs into the goal, then those; None if they never do.

        The motion leaves the velocity curve where the curve rises faster than full effort accelerates.
        """
        way, place, v = self.field.way, self.part.places[0], self.part.speeds[0]
        sampled = np.hstack([leg.state(np.linspace(leg.begin, leg.end, POSES_PER_PART)) for leg in back])

        def top(at: Any) -> Any:
            return way * _leg_at(back, at).speed_at(at) if np.ndim(at) == 0 else np.interp(way * at, *(way * sampled))

        found: list[Leg] = []
        if way * v > (1 + _SAME_SPEED) * top(place):
            return None  # too fast to stop
        while True:
            ahead = self._leg(place, v, self.part.places[-1], towards=True)
            end = self._first_above(ahead, top)
            if end is None:
                return None
            met_at = float(ahead.state(end)[0])
            along, left_at = self._along(back, met_at)
            found += [replace(ahead, end=end), *along] if way * (met_at - place) > self.beside else along
            if left_at is None:
                return found
            if way * (left_at - place) <= self.beside:  # rounding: the motion does not get away from the curve
                return None
            place, v = left_at, way * float(self._fastest_at(left_at))

    def _along(self, back: list[Leg], place: float) -> tuple[list[Leg], float | None]:
        """Return the legs from a position into the goal, and the position where no motion can follow them, or None."""
        way, found = self.field.way, []
        for leg in back:
            last = float(leg.state(leg.end)[0])
            if way * (last - place) <= self.beside:
                continue
            own = replace(leg, begin=leg.time_at(place))
            if leg.held is NO_ROOM:
                return found, float(own.state(own.begin)[0])
            if leg.held is not None:
                first = float(own.state(own.begin)[0])
                inside = self.places[(way * (self.places - first) > self.beside) & (way * (last - self.places) > 0)]
                left_at = self.curve.sign_change(np.concatenate([[first], inside, [last]]), towards=True, sign=1.0)
                if left_at != last:
                    return [*found, replace(own, end=own.time_at(left_at))], left_at
            found.append(own)
        return found, None
