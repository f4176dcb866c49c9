"""May a motion that rests on its way be quicker than one that does not? A bound from below, before anything is searched.

With one degree of freedom every motion consists of legs from rest to rest. Without dampers a leg between two places is
known in closed form: its energy is the least of what full effort has given since the one and what full effort can take
until the other, E(s) = min(W_a(s), W_b(s)), and its time the integral of ds / v. Dampers only take energy, and so make legs
longer. The shortest way over a grid of places, the leg from start to goal left out, bounds all detours from below.
"""

import numpy as np

from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.search.phase_grid import Plane, grid_of, plane_of
from linkplan.planner.search.phase_plane import parts_of

# Cells of the grid, and places on it where a motion may rest.
_CELLS, _PLACES = 400, 60
# A bound within this share of a motion's duration asks for a closer look: five times the grid's own error.
_ROOM = 0.01


def detour_may_pay(problem: PlanningProblem, start_pose: np.ndarray, duration_s: float) -> bool:
    """Return whether another reach may be quicker than a straight one of least time that takes `duration_s`.

    Args:
        problem: of one degree of freedom.
        start_pose: closed (n_q,), at the start.
        duration_s: of a motion that is a local optimum.
    """
    import scipy

    motion = problem.motion
    if motion.kind != "reach" or motion.stays or motion.waypoints or not np.all(np.isfinite(problem.limits.effort)):
        return True
    (part,) = parts_of(motion)
    grid = None if any(part.speeds) else grid_of(problem, part.places, start_pose, _CELLS, graded=False)
    if grid is None:
        return True
    plane = plane_of(problem, *grid, problem.limits.effort)
    if min(plane.drag) < 0:
        return True
    start, goal = plane.at(part.places[0]), plane.at(part.places[-1])
    rests = np.linspace(0, len(plane.s) - 1, _PLACES).round().astype(int)
    places = np.unique(np.concatenate([[start, goal], rests, *_furthest(plane, start)]))
    times = np.full((len(places), len(places)), np.inf)
    for row, place in enumerate(places):
        times[row, row + 1 :] = _legs(plane, int(place), places[row + 1 :], +1)
        times[row, :row] = _legs(plane, int(place), places[:row], -1)
    first, last = np.searchsorted(places, [start, goal])
    if not np.isfinite(times[first, last]):
        return True  # the way straight there is not open: what was found swings already
    times[first, last] = np.inf
    graph = scipy.sparse.csgraph
    detour = graph.dijkstra(graph.csgraph_from_dense(times, null_value=np.inf), indices=first)[last]
    return bool(detour < (1 - _ROOM) * duration_s)


def _energies(plane: Plane, place: int, way: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the energies (n,) that full effort gives along a way from rest at a place, and takes until rest there."""
    gives, takes = np.array(plane.work[way]), np.array(plane.work[-way])
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
    inertia, top = (np.array(x)[stretch] for x in (plane.inertia, plane.top[way]))
    given = np.minimum(_energies(plane, start, way)[0][stretch], inertia * top)
    takes = np.array(plane.work[-way])
    index = np.arange(stretch.start, stretch.stop)
    before = (ends[:, None] - index) * way >= 0
    energy = np.minimum(given, takes[stretch] - takes[ends][:, None])
    closed = np.any(before & (index != start) & (index != ends[:, None]) & (energy <= 0), axis=1)
    v = np.sqrt(2 * np.maximum(energy, 0.0) / inertia)
    with np.errstate(divide="ignore"):
        cells = 2 * np.diff(plane.s[stretch]) / (v[:, 1:] + v[:, :-1])
    return np.where(closed, np.inf, np.where(before[:, 1:] & before[:, :-1], cells, 0.0).sum(axis=1))
