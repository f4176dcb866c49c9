"""May another reach be quicker than the one that was found? A bound from below, before anything is searched.

A motion of one degree of freedom consists of legs from rest to rest. Without dampers a leg between two places is
known in closed form: its energy is the least of what full effort has given since the one and what full effort can take
until the other, E(s) = min(W_a(s), W_b(s)), and its time the integral of ds / v. Dampers only take energy, and so make legs
longer. The leg from start to goal and the shortest way over a grid of places bound all reaches from below.
"""

import numpy as np

from linkplan.planner.phase_plane.bang_bang_motions import TURNING_PLACES, parts_of
from linkplan.planner.phase_plane.grid import Plane, grid_of, plane_of
from linkplan.planner.problem.problem import Problem

# Cells of the grid: bounds need fewer than the motion itself.
_GRID_CELLS = 400


def quicker_may_exist(problem: Problem, start_pose: np.ndarray, duration_s: float) -> bool:
    """True if another reach may be quicker than one that takes `duration_s`, directly or by a detour.

    Args:
        problem: of one degree of freedom.
        start_pose: closed (n_q,), at the start.
        duration_s: of a motion that is a local optimum.
    """
    motion = problem.motion
    if motion.kind != "reach" or motion.stays or motion.waypoints or not np.all(np.isfinite(problem.limits.effort)):
        return True
    (part,) = parts_of(motion)
    grid = None if any(part.speeds) else grid_of(problem, part.places, start_pose, _GRID_CELLS, graded=False)
    if grid is None:
        return True
    plane = plane_of(problem, *grid, problem.limits.effort)
    if np.any(plane.drag < 0):
        return True
    start, goal = plane.at(part.places[0]), plane.at(part.places[-1])
    rests = np.linspace(0, len(plane.s) - 1, TURNING_PLACES).round().astype(int)
    places = np.unique(np.concatenate([[start, goal], rests, *_furthest(plane, start)]))
    first, last = np.searchsorted(places, [start, goal])
    straight = _legs(plane, start, np.array([goal]), 1 if goal > start else -1)[0] if goal != start else np.inf
    if not np.isfinite(straight):
        return True  # the way straight there is not open: what was found swings already
    # A bound within this share of a motion's duration is not decisive: five times the error of the grid.
    quick = (1 - 0.01) * duration_s
    if straight < quick:
        return True
    if _least_detour(_bounds(plane, places), first, last) >= quick:
        return False
    times = np.full((len(places), len(places)), np.inf)
    for row, place in enumerate(places):
        times[row, row + 1 :] = _legs(plane, int(place), places[row + 1 :], +1)
        times[row, :row] = _legs(plane, int(place), places[:row], -1)
    return _least_detour(times, first, last) < quick


def _least_detour(times: np.ndarray, first: int, last: int) -> float:
    """Return the least time [s] from one place to another by several legs of `times` (k, k)."""
    times = np.array(times)
    times[first, last] = np.inf
    least, before = times[first], None
    while before is None or np.any(least < before):  # ways of a leg more each time (Bellman and Ford)
        before, least = least, np.minimum(least, (least[:, None] + times).min(axis=0))
    return float(least[last])


def _bounds(plane: Plane, places: np.ndarray) -> np.ndarray:
    """Return bounds from below (k, k) [s] of the legs' times, nearly as good as those and much sooner known.

    Until a place between its ends a leg is no quicker than full effort from the one, from there on no quicker than full
    effort would have to begin to come to rest at the other; the best of these bounds is at the place next to the switch.
    """
    after = places - places[:, None]
    bounds = np.full(after.shape, np.inf)
    for way in (+1, -1):
        begun = np.where(way * after >= 0, _alone(plane, places, way, way), -np.inf)
        ended = np.where(way * after <= 0, _alone(plane, places, -way, way), -np.inf)
        bound = np.max(begun[:, None, :] + ended[None, :, :], axis=2)
        bounds = np.where(way * after > 0, bound, bounds)
    return bounds


def _alone(plane: Plane, places: np.ndarray, way: int, top: int) -> np.ndarray:
    """Return the times (k, k) [s] by full effort from rest at each place along a way, within the speeds of way `top`."""
    inertia, work = plane.inertia, plane.work[way]
    energy = np.minimum(work - work[places][:, None], inertia * plane.top[top])
    v = np.sqrt(2 * np.maximum(energy, 0.0) / inertia)
    with np.errstate(divide="ignore"):
        cells = 2 * np.diff(plane.s) / (v[:, 1:] + v[:, :-1])
    number, at = np.arange(cells.shape[1]), places[:, None]
    times = np.zeros(v.shape)
    if way > 0:
        times[:, 1:] = np.cumsum(np.where(number >= at, cells, 0.0), axis=1)
    else:
        times[:, :-1] = np.cumsum(np.where(number < at, cells, 0.0)[:, ::-1], axis=1)[:, ::-1]
    # The time of a path that is blocked [s]: finite, because infinities of both signs have no sum.
    return np.minimum(times[:, places], 1e300)


def _energies(plane: Plane, place: int, way: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the energies (n,) that full effort gives along a way from rest at a place, and takes until rest there."""
    gives, takes = plane.work[way], plane.work[-way]
    return gives - gives[place], takes - takes[place]


def _furthest(plane: Plane, start: int) -> list[list[int]]:
    """Return the places where full effort comes to rest by itself: from the start, and from those back again."""
    found: list[list[int]] = []
    for way in (+1, -1):
        at = start
        for turn in (way, -way):
            energy = _energies(plane, at, turn)[0][at::turn][1:]
            stops = np.flatnonzero(energy <= 0)
            if not len(stops) or not stops[0]:
                break
            at += turn * int(stops[0])
            found.append([at])
    return found


def _legs(plane: Plane, start: int, ends: np.ndarray, way: int) -> np.ndarray:
    """Return the least times (k,) [s] of legs without dampers from a place to others along one way; infinite where shut."""
    if not len(ends):
        return np.empty(0)
    stretch = slice(start, int(ends[-1]) + 1) if way > 0 else slice(int(ends[0]), start + 1)
    inertia, top = (x[stretch] for x in (plane.inertia, plane.top[way]))
    given = np.minimum(_energies(plane, start, way)[0][stretch], inertia * top)
    takes = plane.work[-way]
    index = np.arange(stretch.start, stretch.stop)
    before = (ends[:, None] - index) * way >= 0
    energy = np.minimum(given, takes[stretch] - takes[ends][:, None])
    closed = np.any(before & (index != start) & (index != ends[:, None]) & (energy <= 0), axis=1)
    v = np.sqrt(2 * np.maximum(energy, 0.0) / inertia)
    with np.errstate(divide="ignore"):
        cells = 2 * np.diff(plane.s[stretch]) / (v[:, 1:] + v[:, :-1])
    return np.where(closed, np.inf, np.where(before[:, 1:] & before[:, :-1], cells, 0.0).sum(axis=1))
