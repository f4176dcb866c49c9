"""Energy balances of one degree of freedom: bounds on the least time, and motions that cannot stop.

They are known before anything is searched.

A motion of one degree of freedom consists of legs from rest to rest. Without dampers a leg between two places is known in
closed form: its energy is the least of what full effort has given since the one and what full effort can take until the
other, E(s) = min(W_a(s), W_b(s)), and its time the integral of ds / v. Dampers only take energy, and so make legs longer.
The leg from start to goal and the shortest way over a grid of places bound all reaches from below.

A motion that begins at speed loses the most energy under full effort against it (Bobrow, Dubowsky & Gibson, Int. J. Robotics
Research 4, 1985). Where energy is left at the end of the range, no motion stays within it. Run backwards, the same holds for
a motion that ends at speed.
"""

from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.models.poses.assembly import close_at, follow
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


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _End:
    """An end of a reach: its words, position, speed, whether time runs on from it (1) or back (-1), and the other end."""

    name: str
    position: float
    speed: float
    along: int
    other: float
    other_speed: float


def no_way_to_stop(problem: Problem) -> str | None:
    """Return the sentence on a speed at start or goal that no effort stops or gives within the joint's range, or None."""
    motion, mechanism = problem.motion, problem.mechanism
    if mechanism.dof != 1 or motion.kind != "reach" or motion.goal_is_free or not np.all(np.isfinite(problem.limits.effort)):
        return None
    first, last = (0.0 if v is None else float(v[0]) for v in (motion.start_speed, motion.goal_speed))
    start, goal = float(motion.start[0]), float(motion.goal[0])
    ends = (
        _End(name="start", position=start, speed=first, along=1, other=goal, other_speed=last),
        _End(name="goal", position=goal, speed=last, along=-1, other=start, other_speed=first),
    )
    return next((found for end in ends if end.speed and (found := _beyond_the_range(problem, end)) is not None), None)


def _beyond_the_range(problem: Problem, end: _End) -> str | None:
    mechanism, limit = problem.mechanism, problem.limits.position
    way, (joint,) = int(np.sign(end.speed)), mechanism.independent_joints
    step = way * end.along
    bound = limit[mechanism.independent[0], 1 if step > 0 else 0]
    if not np.isfinite(bound) or step * (bound - end.position) <= 0:
        return None
    s = np.linspace(end.position, bound, 801)
    fine = np.interp(np.arange(2 * len(s) - 1) / 2, np.arange(len(s)), s)
    try:
        poses = follow(mechanism, fine[:, None], close_at(mechanism, np.array([end.position])), problem.solver.deadline)
    except AssemblyError:  # the reach ends before the range
        return None
    at, ahead = 0, 1
    if step < 0:
        s, poses, at, ahead = s[::-1], poses[::-1], len(s) - 1, -1
    plane = plane_of(problem, s, poses, problem.limits.effort)
    w = plane.leg(at, 0.5 * end.speed**2, ahead, -ahead, backwards=end.along < 0)
    # The share of the squared speed that must be left there is a hundred times the error of the quadrature.
    if len(w) < len(s) or w[-1] < 1e-4 * w[0]:
        return None
    passed = int(np.argmin(np.abs(s - end.other)))
    on_the_way = step * (end.other - end.position) > 0 and step * (bound - end.other) > 0
    if on_the_way and way * end.other_speed > 0 and w[abs(passed - at)] <= 0.5 * end.other_speed**2:
        return None
    does = "stops" if end.along > 0 else "gathers"
    room = abs(joint.shown(bound - end.position))
    return (
        f"infeasible: no effort within its limits {does} the {abs(joint.shown(end.speed)):.4g} {joint.unit}/s of joint"
        f" {joint.name} at the {end.name} within the {room:.4g} {joint.unit} to the end of its range at"
        f" {joint.said(bound, 5)} {joint.unit}"
    )
