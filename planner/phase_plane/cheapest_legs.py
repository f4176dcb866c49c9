"""Motions of least squared effort in a given time, for one degree of freedom and one actuator, as legs over position.

The independent variable is the position s, on a grid of cells. The effort of a cell follows from the speeds v at its ends,
u = (d(M v^2 / 2) - dW) / (r ds) with the reduced inertia M, the work W of weight, springs and friction, and the actuator's
speed r per unit of v. Cells are shorter where joints or the inertia change most with s. A linkage may pass a dead centre
within a thousandth of the motion, which a mesh over time does not resolve. The duration is the sum of 2 ds / (v + v'). The
remainder of the given time is a rest, with the cost of holding still. A motion goes directly to its goal, or turns back
once, beyond its start or its goal. Several turning points are tried, then those around the best one. Whole turns are one
leg that ends at the speed at which it began, and have no rest.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from linkplan.planner.closed_chain.guess import Guess, guess_along
from linkplan.planner.phase_plane.bang_bang_motions import is_plain_turn, parts_of, phase_plane_applies, turn_places
from linkplan.planner.phase_plane.grid import PhasePlane, grid_of, plane_of
from linkplan.planner.problem.limits import within_reserve
from linkplan.planner.problem.problem import Problem

# Cells of the grid, cells of a leg while turning places are tried, and how many are tried on either side of the way.
_GRID_CELLS, _FEW_CELLS, _TURNING_PLACES = 1600, 200, 6
# Shares of the effort limits that are left for the polynomials between cell ends, in turn.
_EFFORT_RESERVES = (0.01, 0.03, 0.1)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Legs:
    """A motion at the ends of its cells: times (n,) [s], positions (n,), speeds (n,), and the cost including the rest."""

    time: np.ndarray
    s: np.ndarray
    v: np.ndarray
    cost: float

    def breaks(self) -> np.ndarray:
        """Return the ends [s] of a moderate number of intervals with equal numbers of cells."""
        return self.time[self._ends()]

    def guess(self, start_pose: np.ndarray) -> Guess:
        """Return the motion as a guess: cubic polynomials between the breaks."""
        import scipy

        ends = self._ends()
        path = scipy.interpolate.CubicHermiteSpline(self.time[ends], self.s[ends, None], self.v[ends, None])
        return guess_along(path, float(self.time[-1]), start_pose, swings=max(1, int(np.count_nonzero(self.v == 0)) - 1))

    def _ends(self) -> np.ndarray:
        last = len(self.time) - 1
        step = max(1, int(np.ceil(last / 800)))  # at most 800 intervals
        return np.unique(np.concatenate([np.arange(0, last, step), [last], np.flatnonzero(self.v == 0)]))


def legs_apply(problem: Problem) -> bool:
    """True for squared effort, one actuator, one degree of freedom, and a fixed duration from rest to rest or of turns."""
    motion = problem.motion
    if (problem.mechanism.dof, problem.mechanism.n_u) != (1, 1) or motion.duration_s is None:
        return False
    speeds = [v for v in (motion.start_speed, motion.goal_speed) if v is not None]
    if not is_plain_turn(problem) and (not phase_plane_applies(problem) or motion.waypoints or np.any(speeds)):
        return False
    return set(problem.objective.weights) <= {"effort", "copper_loss"}


def cheapest_legs(problem: Problem, start_pose: np.ndarray, rest: float | None) -> Iterator[Legs]:
    """Yield legs of least squared effort in the given duration, which may include a rest, for increasing effort reserves.

    Args:
        problem: one for which `legs_apply` is true.
        start_pose: the closed pose at the start.
        rest: the squared effort [N2 m2 or N2] of a rest at start or goal; None if neither can be held.
    """
    asked, turns = problem.motion.duration_s, is_plain_turn(problem)
    places = turn_places(problem, start_pose) if turns else parts_of(problem.motion)[0].places
    grid = grid_of(problem, places, start_pose, _GRID_CELLS)
    if grid is None or asked is None:
        return
    way = _Way(plane=plane_of(problem, *grid), asked=asked, rest=rest, repeats=turns)
    ends = [way.plane.at(place) for place in places]
    first = [None] if turns else way.turns(ends)
    tried = {turn: found for turn in first if (found := way.legs(ends, turn, _FEW_CELLS)) is not None}
    if not tried:
        return
    best = min(tried, key=lambda turn: tried[turn].cost)
    if best is not None:
        near = way.turns(ends, best)
        tried |= {turn: found for turn in near if (found := way.legs(ends, turn, _FEW_CELLS)) is not None}
        best = min(tried, key=lambda turn: tried[turn].cost)
    for reserve in _EFFORT_RESERVES:
        legs = way.legs(ends, best, _GRID_CELLS, reserve)
        if legs is not None:
            yield legs


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Way:
    """The phase plane of the legs, the required duration [s], and the squared effort of a rest or None.

    A motion that `repeats` is one leg that ends at its first speed; other legs begin and end at rest.
    """

    plane: PhasePlane
    asked: float
    rest: float | None
    repeats: bool

    def turns(self, ends: list[int], near: int | None = None) -> Iterator[int | None]:
        """Yield the cell ends at which a motion may turn back (None: it goes directly), or those next to a given one."""
        low, high = sorted(ends)
        sides = [np.linspace(low, 0, _TURNING_PLACES + 1), np.linspace(high, len(self.plane.s) - 1, _TURNING_PLACES + 1)]
        if near is None:
            yield None
            yield from (int(at) for side in sides for at in side[1:].round() if at not in (low, high))
            return
        side = sides[0] if near < low else sides[1]
        step = abs(side[1] - side[0])
        close = np.unique((near + step * np.array([-0.67, -0.33, 0.33, 0.67])).round().astype(int))
        yield from (int(at) for at in close if 0 <= at < len(self.plane.s) and not low <= at <= high)

    def legs(self, ends: list[int], turn: int | None, cells: int, reserve: float = 0.0) -> Legs | None:
        """Return the best legs over a turning point with at most a number of cells; None if no efforts produce such legs."""
        start, goal = ends
        stops = [start, goal] if turn is None else [start, turn, goal]
        time, cost, efforts, unknowns, begin, parts = ca.SX(0), ca.SX(0), [], [], [], []
        for first, last in itertools.pairwise(stops):
            way = 1 if last > first else -1
            step = max(1, abs(last - first) // cells)
            at = np.append(np.arange(first, last, way * step), last)
            free = ca.SX.sym("v", len(at) - (1 if self.repeats else 2))
            speed, ds = self._speeds(free), np.abs(np.diff(self.plane.s[at]))
            taken = 2 * ds / (speed[1:] + speed[:-1])
            effort = self._efforts(at, way, speed, ds)
            time, cost = time + ca.sum1(taken), cost + ca.dot(effort**2, taken)
            share = np.abs(self.plane.s[at] - self.plane.s[first])[1:-1] / ds.sum()
            efforts, unknowns = [*efforts, effort], [*unknowns, free]
            begin.append(ds.sum() * (np.ones(len(at) - 1) if self.repeats else 4 * np.sqrt(share * (1 - share))))
            parts.append((at, way))
        rest = self.rest or 0.0
        limit = np.sort([[self.plane.effort[way][0, 0] for way in (-1, 1)]])
        bounds = (0.0 if self.rest is not None else self.asked), self.asked, within_reserve(limit, reserve)[0]
        first = np.concatenate(begin)
        solved = _solved(ca.vertcat(*unknowns), cost - rest * time, time, ca.vertcat(*efforts), first, bounds)
        if solved is None:
            return None
        found = np.split(solved[0], np.cumsum([len(one) for one in begin])[:-1])
        speeds = [np.array(self._speeds(ca.DM(one))).ravel() for one in found]
        return _joined(self.plane, parts, speeds, solved[1] + rest * self.asked)

    def _speeds(self, free: Any) -> Any:
        """Return the speeds (n,) at the cell ends of a leg from the unknown ones."""
        return ca.vertcat(free, free[0]) if self.repeats else ca.vertcat(0, free, 0)

    def _efforts(self, at: np.ndarray, way: int, speed: ca.SX, ds: np.ndarray) -> ca.SX:
        """Return the efforts (n - 1,) of the cells between cell ends (n,) from the speeds (n,) at these ends."""
        plane = self.plane
        full = {side: effort[::2, 0][at] for side, effort in plane.effort.items()}
        acts = (plane.force[1][at] - plane.force[-1][at]) / (full[1] - full[-1])
        middle = 0.5 * (acts[1:] + acts[:-1])
        given = np.diff(plane.work[1][at]) - way * ds * 0.5 * ((acts * full[1])[1:] + (acts * full[1])[:-1])
        drag, rub = (0.5 * (x[at][1:] + x[at][:-1]) * ds for x in (plane.drag, plane.rub))
        energy = speed**2 * ca.DM(0.5 * plane.inertia[at])
        gained = energy[1:] - energy[:-1] - (speed[1:] + speed[:-1]) * ca.DM(0.5 * drag) + ca.DM(rub - given)
        return gained / ca.DM(way * middle * ds)


def _solved(
    v: ca.SX, cost: ca.SX, time: ca.SX, efforts: ca.SX, begin: np.ndarray, bounds: tuple[float, float, np.ndarray]
) -> tuple[np.ndarray, float] | None:
    """Return the speeds (n,) of least cost and this cost; None if none satisfy the bounds on time and efforts."""
    least, most, limit = bounds
    first = begin / most
    scale = 1.0 / max(float(np.square(limit).max()) * most, np.finfo(float).tiny)
    options = {"print_time": 0, "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 200}}
    solver = ca.nlpsol("legs", "ipopt", {"x": v, "f": scale * cost, "g": ca.vertcat(time / most, efforts)}, options)
    n = efforts.numel()
    found = solver(
        x0=first,
        lbx=1e-9 * first.max(),
        ubx=np.inf,
        lbg=np.append(least / most, np.full(n, limit[0])),
        ubg=np.append(1.0, np.full(n, limit[1])),
    )
    return (np.array(found["x"]).ravel(), float(found["f"]) / scale) if solver.stats()["success"] else None


def _joined(plane: PhasePlane, parts: list, speeds: list[np.ndarray], cost: float) -> Legs:
    """Return consecutive legs as one motion, from the speeds at their cell ends.

    Within a cell the energy is interpolated smoothly, and the speed follows from the energy and the inertia there.
    """
    import scipy

    time, s, v = [np.zeros(1)], [plane.s[parts[0][0][:1]]], [parts[0][1] * speeds[0][:1]]
    inertia = scipy.interpolate.CubicSpline(plane.s, np.log(plane.inertia))
    for (at, way), speed in zip(parts, speeds, strict=True):
        ends = speed[[0, -1]]
        along = way * plane.s[at]
        energy = scipy.interpolate.PchipInterpolator(along, 0.5 * plane.inertia[at] * speed**2)
        fine = np.interp(np.arange(8 * (len(at) - 1) + 1) / 8, np.arange(len(at)), along)
        speed = np.sqrt(2 * np.maximum(energy(fine), 0.0) / np.exp(inertia(way * fine)))
        speed[[0, -1]] = ends
        time.append(time[-1][-1] + np.cumsum(2 * np.diff(fine) / (speed[1:] + speed[:-1])))
        s.append(way * fine[1:])
        v.append(way * speed[1:])
    return Legs(time=np.concatenate(time), s=np.concatenate(s), v=np.concatenate(v), cost=cost)
