"""Least times of one degree of freedom under limits on effort and power, by integrating both legs of the phase plane."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from linkplan.models.poses.along import sampled
from linkplan.models.poses.assembly import follow
from linkplan.planner.problem.problem import Problem

_POSES, _LONGEST_S, _STEP_S = 4001, 100.0, 0.01
# Next to the ends, this share of the way, the legs are not yet apart.
_BESIDE = 1e-7
# A range of efforts [N.m] this small is none: a leg ends there.
_NONE = 1e-9


@dataclass(frozen=True, eq=False, kw_only=True, slots=True)
class Curves:
    """M a = still + square v^2 + linear v + effort u, each a curve over the coordinate."""

    inertia: Any
    effort: Any
    still: Any
    square: Any
    linear: Any


def least_time(problem: Problem) -> float:
    """Return the least time [s] of a reach from rest to rest of one coordinate and one actuator that never turns back."""
    start, goal = float(problem.motion.start[0]), float(problem.motion.goal[0])
    return least_time_of(curves_of(problem, start, goal), start, goal, problem.limits.effort[0], problem.limits.power[0])


def least_time_of(curves: Curves, start: float, goal: float, limit: Sequence[float], power: Sequence[float]) -> float:
    """Return the least time [s] from rest to rest within limits on effort [N.m] and power [W]."""

    def within(s: float, v: float) -> tuple[float, float]:
        low, high = limit
        push = float(curves.effort(s))
        if push * v:
            ends = sorted(np.asarray(power) / (push * v))
            low, high = max(low, ends[0]), min(high, ends[1])
        return low, high

    return least_time_within(curves, start, goal, within)


def least_time_within(
    curves: Curves, start: float, goal: float, within: Callable[[float, float], tuple[float, float]]
) -> float:
    """Return the least time [s] from rest to rest within what efforts there may be at a place and speed.

    All that is allowed from the start, and back from the goal: the legs cross where the motion switches.
    """
    way = np.sign(goal - start)

    def acceleration(s: float, v: float, towards: bool) -> float:
        low, high = within(s, v)
        push = float(curves.effort(s))
        effort = high if (push * way > 0) == towards else low
        free = curves.still(s) + curves.square(s) * v**2 + curves.linear(s) * v
        return float((free + push * effort) / curves.inertia(s))

    def room(_t: float, y: np.ndarray) -> float:
        low, high = within(y[0], y[1])
        return high - low - _NONE

    room.terminal = True
    ahead, back = (_leg(acceleration, room, *ends) for ends in ((start, goal, True), (goal, start, False)))
    beside = _BESIDE * (goal - start)
    ends = [max(way * start, way * back.y[0][-1]) + abs(beside), min(way * goal, way * ahead.y[0][-1]) - abs(beside)]
    switch = brentq(lambda s: way * (_at(ahead, s)[1] - _at(back, s)[1]), *sorted(way * np.array(ends)), xtol=1e-14)
    return _at(ahead, switch)[0] - _at(back, switch)[0]


def curves_of(problem: Problem, start: float, goal: float) -> Curves:
    dynamics, way = problem.mechanism.dynamics, np.sign(goal - start)
    place = np.linspace(start, goal, _POSES)
    q = follow(problem.mechanism, place[:, None], problem.start_pose())
    inertia = sampled(dynamics.reduced_inertia, q)[:, 0, 0]
    none = np.zeros((_POSES, 1))
    still, fast, back = (
        inertia * sampled(dynamics.acceleration, q, np.full((_POSES, 1), v), none)[:, 0, 0] for v in (0.0, 1.0, -1.0)
    )
    values = [inertia, sampled(dynamics.effort_map, q)[:, 0, 0], still, 0.5 * (fast + back) - still, 0.5 * (fast - back)]
    M, B, h, d, c = (CubicSpline(place[:: int(way)], value[:: int(way)]) for value in values)
    return Curves(inertia=M, effort=B, still=h, square=d, linear=c)


def _leg(acceleration: Callable[[float, float, bool], float], room, begin: float, end: float, towards: bool):
    def rates(_t: float, y: np.ndarray) -> list[float]:
        return [y[1], acceleration(y[0], y[1], towards)]

    def there(_t: float, y: np.ndarray) -> float:
        return y[0] - end

    there.terminal = True
    until = _LONGEST_S if towards else -_LONGEST_S
    kept = {"rtol": 1e-11, "atol": 1e-13, "max_step": _STEP_S, "dense_output": True}
    return solve_ivp(rates, (0.0, until), [begin, 0.0], events=(there, room), **kept)


def _at(leg, place: float) -> tuple[float, float]:
    """Return when a leg passes a place [s], and how fast."""
    time = brentq(lambda t: leg.sol(t)[0] - place, *sorted([0.0, leg.t[-1]]), xtol=1e-15)
    return time, leg.sol(time)[1]
