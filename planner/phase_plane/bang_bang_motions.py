"""Bang-bang motions of one degree of freedom by the phase plane, including swings that build up energy.

Along s the energy w = v^2 / 2 satisfies dw/ds = a(s, v, u) (Bobrow, Dubowsky & Gibson, Int. J. Robotics Research 4, 1985). A
leg is a stretch of motion in one direction. One leg accelerates from rest with full effort, and another brakes to rest at
the goal. They cross at the switch. With the reduced inertia M(s), the energy M w changes only by the work of weight and
efforts. Legs are therefore exact in energy, even where M changes quickly near a singular pose. If no direct motion exists,
the quickest sequence of legs over a grid of turning points is searched. The motions are initial guesses for a solver, which
finds the optimum under all limits, including those that the phase plane ignores.
"""

import heapq
import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.deadline import Deadline
from linkplan.planner.closed_chain.guess import Guess, guess_along, stretched
from linkplan.planner.limits.kinds import are_efforts_bounded
from linkplan.planner.phase_plane.grid import PhasePlane, grid_of, plane_of
from linkplan.planner.problem.motion import Motion
from linkplan.planner.problem.problem import Problem

# Cells of the grid, and places on it at which a motion may rest and turn.
_GRID_CELLS, _TURNING_PLACES = 1600, 60
# The smallest speed in sums of times [rad/s or m/s].
_MIN_SPEED = 1e-9
# Energies at which a turn is tried, as multiples of the energy at which dampers take full effort on average.
_TURN_ENERGIES = np.geomspace(1e-3, 1e3, 25)
# Energies that differ by less than this share are the same.
_SAME_ENERGY_SHARE = 1e-6


def least_time_guess(problem: Problem, start_pose: np.ndarray) -> Guess | None:
    """Return the least-time reach or turn of the phase plane, whatever the problem's duration; None if there is none."""
    if problem.mechanism.forces is not None:
        return None
    if problem.motion.turns is not None:
        return _quickest_turn(problem, start_pose)
    return _planes(problem, start_pose)(1.0) if phase_plane_applies(problem) else None


def _quickest_turn(problem: Problem, start_pose: np.ndarray) -> Guess | None:
    """Return the full-effort turn with equal energy before and after; None if dampers cannot absorb the effort's work.

    The dampers absorb more at a higher initial energy, so the energy gained decreases. Its zero gives the quickest turn.
    """
    if not is_plain_turn(problem):
        return None
    places = turn_places(problem, start_pose)
    way = int(np.sign(places[1] - places[0]))
    grid = grid_of(problem, places, start_pose, _GRID_CELLS)
    if grid is None:
        return None
    plane = plane_of(problem, *grid)
    start, goal = (plane.at(place) for place in places)
    index = np.arange(start, goal + way, way)

    def turned(w: float) -> np.ndarray:
        leg = plane.leg(start, w, way, way)[: len(index)]
        return np.pad(leg, (0, len(index) - len(leg)))

    given = plane.work[way][goal] - plane.work[way][start]
    taken = -np.sum(plane.drag[:-1] * plane.cells)
    energies = _TURN_ENERGIES * 0.5 * (given / taken) ** 2 if given > 0 and taken > 0 else np.empty(0)
    gains = np.array([turned(w)[-1] - w for w in energies])
    steady = np.flatnonzero((gains[:-1] > 0) & (gains[1:] <= 0))
    if not len(steady):
        return None
    low, high = (float(w) for w in energies[steady[-1] : steady[-1] + 2])
    for _ in range(40):  # to rounding
        middle = 0.5 * (low + high)
        low, high = (middle, high) if turned(middle)[-1] > middle else (low, middle)
    w = turned(low)
    speed = float(way * np.sqrt(2 * low))
    return _guess(plane, [Part(places=places, speeds=(speed, speed))], [[(index, w, np.full(len(index), way))]], start_pose)


def is_plain_turn(problem: Problem) -> bool:
    """True for whole turns of one degree of freedom, without waypoints or forces over time, with limits on all efforts."""
    motion, mechanism = problem.motion, problem.mechanism
    if mechanism.forces is not None or mechanism.n_equations != 1 or motion.turns is None:
        return False
    return not motion.waypoints and motion.goal is None and are_efforts_bounded(problem)


def turn_places(problem: Problem, start_pose: np.ndarray) -> np.ndarray:
    """Return the first and the last position (2,) of whole turns."""
    first = start_pose[problem.mechanism.independent]
    return np.concatenate([first, first + problem.motion.advance])


def phase_plane_applies(problem: Problem) -> bool:
    """True for a reach of one degree of freedom with limits on all efforts and without external forces over time."""
    if (
        problem.mechanism.forces is not None
        or problem.mechanism.n_equations != 1
        or problem.motion.kind != "reach"
        or problem.motion.stays
    ):
        return False
    if any(w.time_s is not None or not np.all(np.isfinite(w.position)) for w in problem.motion.waypoints):
        return False
    return are_efforts_bounded(problem)


def least_share(problem: Problem, start_pose: np.ndarray, duration: float) -> tuple[float, Guess] | None:
    """Return the least factor on the effort limits with which the phase plane finds a reach, and that motion.

    None if no factor up to 1024 gives a motion, or if the phase plane does not apply.

    Args:
        problem: a reach with limits on all efforts.
        start_pose: the closed pose at the start.
        duration: the longest that the motion may take [s].
    """
    if not phase_plane_applies(problem):
        return None
    guess_with = _planes(problem, start_pose)

    def known(share: float) -> Guess | None:
        guess = guess_with(share)
        return guess if guess is not None and guess.duration_s <= duration else None

    low, high, best = 1.0, 2.0, None
    while (best := known(high)) is None:
        low, high = high, 2.0 * high
        if high > 1024.0:
            return None
    for _ in range(8):  # a message names the factor to some thousandths
        middle = float(np.sqrt(low * high))
        guess = known(middle)
        low, high, best = (low, middle, guess) if guess is not None else (middle, high, best)
    return high, best


def phase_plane_guess(problem: Problem, quickest: Guess) -> Guess:
    """Return the least-time motion of `least_time_guess`, scaled in time to the problem's duration if that is fixed."""
    duration = problem.motion.duration_s
    return quickest if duration is None else stretched(quickest, duration)


def _planes(problem: Problem, start_pose: np.ndarray) -> Callable[[float], Guess | None]:
    """Return the function from a factor on the effort limits to the quickest motion. The grid's poses are computed once."""
    parts = parts_of(problem.motion)
    places = np.concatenate([part.places for part in parts])
    grid = grid_of(problem, places, start_pose, _GRID_CELLS)

    def guess_with(share: float) -> Guess | None:
        if grid is None:
            return None
        plane = plane_of(problem, *grid, share=share)
        rests = [place for part in parts for place in _resting_places(plane, part) if place is not None]
        if rests:
            finer = grid_of(problem, np.concatenate([places, rests]), start_pose, _GRID_CELLS)
            plane = plane if finer is None else plane_of(problem, *finer, share=share)
        ways = [_legs(plane, part, problem.solver.deadline) for part in parts]
        return None if any(legs is None for legs in ways) else _guess(plane, parts, ways, start_pose)

    return guess_with


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Part:
    """A part of a motion between known speeds, which passes the positions `places` (n,) in this order."""

    places: np.ndarray
    speeds: tuple[float, float]


def parts_of(motion: Motion) -> list[Part]:
    """Return the parts of a reach. It passes a waypoint at the highest possible speed, or at rest if it turns back there."""
    places = np.array([motion.start[0], *(w.position[0] for w in motion.waypoints), motion.goal[0]])
    ends = [0.0 if v is None else float(v[0]) for v in (motion.start_speed, motion.goal_speed)]
    speeds = np.array([ends[0], *(w.speed[0] for w in motion.waypoints), ends[1]])
    turns = np.concatenate([[False], np.diff(places)[1:] * np.diff(places)[:-1] <= 0, [False]])
    speeds[turns & np.isnan(speeds)] = 0.0
    known = np.flatnonzero(~np.isnan(speeds))
    return [
        Part(places=places[a : b + 1], speeds=(float(speeds[a]), float(speeds[b]))) for a, b in itertools.pairwise(known)
    ]


def _resting_places(plane: PhasePlane, part: Part) -> tuple[float | None, float | None]:
    """Return the positions at which full effort stops a moving start, and from which it reaches a moving end.

    None for an end at rest, or if the grid has no such position. The second position is a little farther than necessary.
    """
    found: list[float | None] = []
    for place, v, along in ((part.places[0], part.speeds[0], 1), (part.places[-1], part.speeds[1], -1)):
        way, at = int(np.sign(v)), plane.at(place)
        step = along * way
        leg = plane.leg(at, 0.5 * v**2, step, -step, backwards=along < 0) if way else np.zeros(0)
        last = at + step * (len(leg) - 1)
        if not way or not 0 <= last + step < len(plane.s):
            found.append(None)
            continue
        energy = plane.inertia[last] * leg[-1]
        lost = plane.work[-step][last] - plane.work[-step][last + step]
        rest = plane.s[last] + min(energy / lost, 1.0) * (plane.s[last + step] - plane.s[last])
        # The way over which a motion gains its speed at the goal is longer than necessary by this share.
        found.append(float(rest + (1e-3 * (rest - plane.s[at]) if along < 0 else 0.0)))
    return found[0], found[1]


def _arriving(plane: PhasePlane, ends: list[tuple[int, float]], deadline: Deadline) -> dict[tuple[int, int], np.ndarray]:
    """Return braking legs (w at cell ends) by position and direction of arrival, for places with given speeds."""
    found = {}
    for place, v in ends:
        deadline.require_time()
        for way in (+1, -1):
            if v * way >= 0:
                found[place, way] = plane.leg(place, 0.5 * v**2, -way, -way, backwards=True)
    return found


def _legs(plane: PhasePlane, part: Part, deadline: Deadline):
    """Return the quickest legs of a part (indices, w, directions of the effort at each) over a grid of turning points.

    None if there are none. Dijkstra's algorithm searches the positions at which a motion may rest.
    """
    n, speeds = len(plane.s), part.speeds
    start, goal = plane.at(part.places[0]), plane.at(part.places[-1])
    stop, begin = _resting_places(plane, part)
    rests = {*np.linspace(0, n - 1, _TURNING_PLACES).round().astype(int).tolist()}
    rests = sorted((rests if begin is None else rests | {plane.at(begin)}) - {goal})
    ends = [(goal, speeds[1]), *((place, 0.0) for place in rests)]
    arriving = _arriving(plane, ends, deadline)
    ticket = itertools.count(1)  # equal times are never compared further
    queue, known = [(0.0, 0, 0, start, [])], {}
    if stop is not None and plane.at(stop) != start:
        v = speeds[0]  # full effort stops the part
        way = int(np.sign(v))
        index = np.arange(start, plane.at(stop) + way, way)
        w = plane.leg(start, 0.5 * v**2, way, -way)[: len(index) - 1]
        stopped = index, np.pad(w, (0, len(index) - len(w))), np.full(len(index), -way)
        queue.append((_duration(plane, stopped), next(ticket), 1, plane.at(stop), [stopped]))
    while queue:
        deadline.require_time()
        time, _, legs_so_far, at, legs = heapq.heappop(queue)
        if legs and at == goal:
            return legs
        # The largest number of legs of a motion.
        if known.get(at, np.inf) <= time or legs_so_far == 24:
            continue
        known[at] = time
        v = speeds[0] if not legs else 0.0
        for way in [int(np.sign(v))] if v else [+1, -1]:
            push = plane.leg(at, 0.5 * v**2, way, way)
            index = at + way * np.arange(len(push))
            if len(push) > 1 and index[-1] not in (0, n - 1):
                # The place at which full effort comes to rest by itself is the furthest turn; it need not lie on the grid.
                whole = index, np.append(push[:-1], 0.0), np.full(len(index), way)
                taken = time + _duration(plane, whole)
                heapq.heappush(queue, (taken, next(ticket), legs_so_far + 1, int(index[-1]), [*legs, whole]))
            for place in (place for place, _ in ends if place == goal or place not in known):
                joined = _joined(plane, index, push, place, way, arriving.get((place, way)))
                if joined is not None:
                    taken = time + _duration(plane, joined)
                    heapq.heappush(queue, (taken, next(ticket), legs_so_far + 1, place, [*legs, joined]))
    return None


def _duration(plane: PhasePlane, leg) -> float:
    index, w, _ = leg
    first, last = int(index[0]), int(index[-1])
    cells = plane.cells[first:last] if first <= last else plane.cells[last:first][::-1]
    v = np.sqrt(2 * w)
    return float((2 * cells / np.maximum(v[1:] + v[:-1], _MIN_SPEED)).sum())


def _joined(plane: PhasePlane, index: np.ndarray, push: np.ndarray, goal: int, way: int, brake: np.ndarray | None):
    """Return an accelerating leg until it crosses the braking leg into the goal, then that one; None if they never cross."""
    if brake is None or not (goal - index[0]) * way > 0:
        return None
    ahead = np.arange(index[0], goal + way, way)
    braked = max(len(ahead) - len(brake), 0)  # the first place from which braking leads to the goal
    braking = brake[: len(ahead)][::-1]
    over = push[braked : len(ahead)] >= braking[: max(len(push) - braked, 0)]
    if not over.any():
        return None
    k = braked + int(np.argmax(over))
    # A leg that is above the braking leg already at their first common place is too fast to stop.
    if k == braked and (braked or push[0] > (1 + _SAME_ENERGY_SHARE) * braking[0]):
        return None
    w = np.concatenate([push[:k], braking[k - braked :]])
    if np.any(np.isfinite(plane.top[way])):
        # Below a speed limit, the braking leg's energy may rise faster than full effort can accelerate.
        below = np.full(len(plane.s), np.inf)
        below[ahead[braked:]] = braking
        rest = plane.leg(index[0], push[0], way, way, below=below)
        w[: len(rest)] = rest[: len(w)]
    effort = np.where(np.arange(len(ahead)) < k, way, -way)
    return ahead, w, effort


def _guess(plane: PhasePlane, parts: list[Part], ways: list, start_pose: np.ndarray) -> Guess:
    """Return the legs of all parts as a guess: Hermite cubics of position over time, with the efforts of the legs."""
    import scipy

    visited, times, v, pushes, boundaries = [plane.at(parts[0].places[0])], [0.0], [parts[0].speeds[0]], [], [0]
    for part, legs in zip(parts, ways, strict=True):
        for index, w, effort in legs:
            speed = int(np.sign(index[-1] - index[0])) * np.sqrt(2 * w)
            step = np.abs(np.diff(plane.s[index]))
            times += list(times[-1] + np.cumsum(2 * step / np.maximum(np.abs(speed[1:] + speed[:-1]), _MIN_SPEED)))
            visited += list(index[1:])
            v += list(speed[1:])
            pushes += list(effort[:-1] * 1.0)
        for place in part.places[1:-1]:
            boundaries.append(boundaries[-1] + 1 + visited[boundaries[-1] + 1 :].index(plane.at(place)))
        boundaries.append(len(visited) - 1)
    t, pushed, place = np.array(times), np.array(pushes), plane.s[visited]
    path = scipy.interpolate.CubicHermiteSpline(t, place[:, None], np.array(v)[:, None])

    def effort_at(at: np.ndarray) -> np.ndarray:
        k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(pushed) - 1)
        half = 2 * np.array(visited)[k]
        return np.where(pushed[k, None] > 0, plane.effort[+1][half], plane.effort[-1][half])

    passed = t[boundaries] if len(boundaries) > 2 else None
    guess = guess_along(path, float(t[-1]), start_pose, passed, swings=sum(len(legs) for legs in ways))
    top = np.where(np.array(v) > 0, plane.top[+1][visited], plane.top[-1][visited])
    if np.any((0.5 * np.square(v) >= (1 - _SAME_ENERGY_SHARE) * top) & (top > 0)):
        return guess  # along speed limits, these limits determine the efforts
    switched = np.setdiff1d(np.flatnonzero(np.diff(pushed)) + 1, boundaries)
    ends = np.sort(np.concatenate([t[switched], t[boundaries]]))
    bang_efforts = effort_at(0.5 * (ends[1:] + ends[:-1]))
    return replace(guess, effort=effort_at, switch_times_s=t[switched], bang_efforts=bang_efforts)
