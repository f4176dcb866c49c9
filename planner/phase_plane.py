"""Motions of one degree of freedom by the phase plane: full effort, swings that gather way, and a braking last leg.

Along s the energy w = v^2 / 2 obeys dw/ds = a(s, v, u) (Bobrow, Dubowsky & Gibson, Int. J. Robotics Research 4, 1985): a leg
that pushes with full effort from rest, another that brakes to rest at the goal, and where they cross the switch. With the
reduced inertia M(s), M w grows by the work of weight and effort alone, so that legs keep their energy however quickly M
changes next to a singular pose. Where the way straight there is not open, the quickest one by way of a grid of turns is
looked for. These are starting points where a straight motion is not found; the optimum is left to the solver, and so is
all that this leaves out.
"""

import heapq
import itertools
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from models.along import sampled
from models.assembly import follow, reach
from models.errors import AssemblyError
from planner.guess import Guess
from planner.problem import PlanningProblem

# Cells of the grid over s; two poses a cell.
_CELLS = 800
# The share of a grid's progress that is even in s; the rest goes where joints or the inertia change most.
_EVEN = 0.5
# Legs of a motion at the most, and places on the grid where it may turn.
_SWINGS = 24
_PLACES = 60
# A speed below this counts as this where times are added up [rad/s or m/s].
_STILL = 1e-9
# A crank that turns fully may go so far beyond start and goal [rad].
_TURNS = 2.0 * np.pi
# And anything without an end, so many times the way between start and goal.
_SPANS = 1.5
# Shares of the effort limits tried for a motion that may take longer than the least.
_SHARES = (0.7, 0.4)
# Room kept to the ends of the reach, as a share of it.
_ROOM = 1e-3


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Plane:
    """A grid over s: positions (n,) of cell ends, and there the reduced inertia and its energy's gains.

    d(M w)/ds = dW[direction]/ds + drag v, exact but for dampers that are not linear.
    """

    s: np.ndarray
    inertia: list[float]  # M
    work: dict[int, list[float]]  # W of weight, springs and full effort in direction +1 or -1, from the first position
    force: dict[int, list[float]]  # dW/ds
    drag: list[float]  # M da/dv
    top: list[float]  # largest w by speed limits
    effort: dict[int, np.ndarray]  # (2 n - 1, n_u) that pushes so, at ends and middles in turn

    def leg(self, start: int, w: float, step: int, effort: int, *, backwards: bool = False) -> np.ndarray:
        """Return w at cell ends from `start` on, index by index in steps of +-1, until it would fall to zero or below.

        `effort` is the direction of the push. Backwards, the motion runs against the steps: a braking leg from its end.
        """
        sign, work, at = (-step if backwards else step), self.work[effort], start
        values, energy = [w], self.inertia[start] * w
        if not w and step * self.force[effort][start] <= 0:
            return np.array(values)  # rest is not left that way, however soon the way would be open again
        while 0 <= at + step < len(self.s):
            over = at + step
            h, free = self.s[over] - self.s[at], energy + work[over] - work[at]
            drag = sign * self.drag[at] * (2 * values[-1]) ** 0.5
            ahead = max(free + h * drag, 0.0) / self.inertia[over]
            energy = free + 0.5 * h * (drag + sign * self.drag[over] * (2 * ahead) ** 0.5)
            if energy <= 0:
                break
            at, w = over, min(energy / self.inertia[over], self.top[over])
            energy = self.inertia[at] * w
            values.append(w)
        return np.array(values)


def least_time_guess(problem: PlanningProblem, start_pose: np.ndarray) -> Guess | None:
    """Return a reach in the least time that the phase plane knows, whatever duration is asked; None where there is none."""
    motion = problem.motion
    if problem.mechanism.dof != 1 or motion.kind != "reach" or motion.waypoints:
        return None
    return _guess_with(problem, start_pose, 1.0) if np.all(np.isfinite(problem.limits.effort)) else None


def phase_plane_guess(problem: PlanningProblem, start_pose: np.ndarray, quickest: Guess) -> Guess:
    """Return a reach by the phase plane whose duration is nearest to a fixed one, stretched to it.

    Args:
        problem: of a reach.
        start_pose: closed, at its start.
        quickest: from `least_time_guess`.
    """
    duration = problem.motion.duration_s
    if duration is None:
        return quickest
    weaker = (_guess_with(problem, start_pose, share) for share in _SHARES)
    known = [quickest, *(guess for guess in weaker if guess is not None)]
    return stretched(min(known, key=lambda guess: abs(np.log(guess.duration_s / duration))), duration)


def _guess_with(problem: PlanningProblem, start_pose: np.ndarray, share: float) -> Guess | None:
    plane = _plane(problem, start_pose, share)
    legs = None if plane is None else _legs(plane, problem)
    return None if legs is None else _guess(plane, legs, start_pose)


def _plane(problem: PlanningProblem, start_pose: np.ndarray, share: float) -> _Plane | None:
    mechanism, motion, limits = problem.mechanism, problem.motion, problem.limits
    ends = np.sort([motion.start[0], motion.goal[0]])
    can = reach(mechanism)
    low, high = limits.position[mechanism.independent[0]]
    if can.turns_fully:
        beyond = max(_TURNS, _SPANS * float(ends[1] - ends[0]))
        low, high = max(low, ends[0] - beyond), min(high, ends[1] + beyond)
    else:
        low, high = max(low, can.lower.position), min(high, can.upper.position)
    room = _ROOM * (high - low)
    s = np.linspace(min(low + room, ends[0]), max(high - room, ends[1]), _CELLS + 1)
    gridded = _followed(problem, s, start_pose)
    if gridded is None:
        return None
    s, poses = gridded
    # The part around the start in which every joint keeps its range.
    inside = np.all((poses >= limits.position[:, 0]) & (poses <= limits.position[:, 1]), axis=1)
    begin, out = 2 * int(np.argmin(np.abs(s - motion.start[0]))), np.flatnonzero(~inside)
    first = int(out[out < begin].max(initial=-1)) + 1
    last = int(out[out > begin].min(initial=len(poses))) - 1
    first, last = (first + 1) // 2, last // 2
    s, poses = s[first : last + 1], poses[2 * first : 2 * last + 1]
    if len(s) < 3 or not s[0] <= ends[0] <= ends[1] <= s[-1]:
        return None
    gridded = _followed(problem, _graded(problem, s, poses[::2]), start_pose)
    return None if gridded is None else _gridded(problem, *gridded, share * limits.effort)


def _followed(problem: PlanningProblem, s: np.ndarray, start_pose: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Return positions (n,) with start and goal among them, and the poses (2 n - 1, n_q) at and between them.

    None where the loops open on the way.
    """
    ends = [problem.motion.start[0], problem.motion.goal[0]]
    room = 1e-9 * (s[-1] - s[0])
    apart = np.all(np.abs(s[:, None] - ends) > room, axis=1)
    s = np.unique(np.concatenate([s[apart], ends]))
    fine = np.interp(np.arange(2 * len(s) - 1) / 2, np.arange(len(s)), s)
    begin = int(np.argmin(np.abs(fine - ends[0])))
    try:
        after = follow(problem.mechanism, fine[begin:, None], start_pose)
        before = follow(problem.mechanism, fine[begin::-1, None], start_pose)[::-1]
    except AssemblyError:
        return None
    return s, np.vstack([before[:-1], after])


def _graded(problem: PlanningProblem, s: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Return positions (n,) between the same ends, closer together where joints move or the inertia changes quickly."""
    inertia = sampled(problem.mechanism.dynamics.reduced_inertia, poses)[:, 0, 0]
    steps = np.abs(np.diff(np.column_stack([poses, np.log(inertia)]), axis=0))
    share = (steps / np.maximum(steps.sum(axis=0), np.finfo(float).tiny)).mean(axis=1)
    share = (1 - _EVEN) * share / share.sum() + _EVEN * np.diff(s) / (s[-1] - s[0])
    progress = np.concatenate([[0.0], np.cumsum(share)])
    return np.interp(np.linspace(0.0, progress[-1], len(s)), progress, s)


def _gridded(problem: PlanningProblem, s: np.ndarray, poses: np.ndarray, limit: np.ndarray) -> _Plane:
    """Return the plane over positions (n,) with poses (2 n - 1, n_q) and effort limits (n_u, 2)."""
    dynamics, n = problem.mechanism.dynamics, len(poses)

    def acceleration(v: float, u: np.ndarray) -> np.ndarray:
        return sampled(dynamics.acceleration, poses, np.full((n, 1), v), u)[:, 0, 0]

    inertia = sampled(dynamics.reduced_inertia, poses)[:, 0, 0]
    none = np.zeros((n, len(limit)))
    ahead, back = (acceleration(v, none) for v in (1.0, -1.0))
    maps = sampled(dynamics.effort_map, poses)[:, 0]
    effort = {way: np.where(way * maps > 0, limit[:, 1], limit[:, 0]) for way in (+1, -1)}
    force = {way: inertia * acceleration(0.0, u) for way, u in effort.items()}
    gains = {way: np.diff(s) * (f[:-2:2] + 4 * f[1::2] + f[2::2]) / 6 for way, f in force.items()}
    return _Plane(
        s=s,
        inertia=inertia[::2].tolist(),
        work={way: [0.0, *np.cumsum(gain).tolist()] for way, gain in gains.items()},
        force={way: f[::2].tolist() for way, f in force.items()},
        drag=(0.5 * inertia * (ahead - back))[::2].tolist(),
        top=_top(problem, poses[::2]).tolist(),
        effort=effort,
    )


def _top(problem: PlanningProblem, poses: np.ndarray) -> np.ndarray:
    """Return the largest w = v^2 / 2 at poses (n, n_q) that every joint's speed limit admits."""
    mechanism, speed = problem.mechanism, np.abs(problem.limits.speed).min(axis=1)
    ratio = np.array([np.abs(np.array(mechanism.dynamics.velocity_map(q))[:, 0]) for q in poses])
    with np.errstate(divide="ignore", invalid="ignore"):
        fastest = np.where(ratio > 0, speed / ratio, np.inf).min(axis=1)
    return 0.5 * fastest**2


def _legs(plane: _Plane, problem: PlanningProblem):
    """Return legs (indices, w, directions of the push at each) from start to goal, the quickest by way of a grid of turns.

    None where there is no way. Dijkstra over the places where a motion may rest.
    """
    motion, n = problem.motion, len(plane.s)
    start, goal = (int(np.argmin(np.abs(plane.s - x[0]))) for x in (motion.start, motion.goal))
    speeds = [0.0 if v is None else float(v[0]) for v in (motion.start_speed, motion.goal_speed)]
    rests = sorted({*np.linspace(0, n - 1, _PLACES).round().astype(int).tolist()} - {goal})
    ends = [(goal, speeds[1]), *((place, 0.0) for place in rests)]
    arriving = {}  # braking legs by where and in which direction they arrive
    for place, v in ends:
        for way in (+1, -1):
            if v * way >= 0:
                arriving[place, way] = plane.leg(place, 0.5 * v**2, -way, -way, backwards=True)
    ticket = itertools.count(1)  # equal times are never compared further
    queue, known = [(0.0, 0, 0, start, [])], {}
    while queue:
        time, _, legs_so_far, at, legs = heapq.heappop(queue)
        if legs and at == goal:
            return legs
        if known.get(at, np.inf) <= time or legs_so_far == _SWINGS:
            continue
        known[at] = time
        v = speeds[0] if not legs else 0.0
        for way in [int(np.sign(v))] if v else [+1, -1]:
            push = plane.leg(at, 0.5 * v**2, way, way)
            index = at + way * np.arange(len(push))
            if len(push) > 1 and index[-1] not in (0, n - 1):
                # Where full effort comes to rest by itself: the furthest turn, and on no grid.
                whole = index, np.append(push[:-1], 0.0), np.full(len(index), way)
                taken = time + _duration(plane, whole)
                heapq.heappush(queue, (taken, next(ticket), legs_so_far + 1, int(index[-1]), [*legs, whole]))
            for place, _ in ends:
                joined = _joined(plane, index, push, place, way, arriving.get((place, way)))
                if joined is not None:
                    taken = time + _duration(plane, joined)
                    heapq.heappush(queue, (taken, next(ticket), legs_so_far + 1, place, [*legs, joined]))
    return None


def _duration(plane: _Plane, leg) -> float:
    index, w, _ = leg
    v = np.sqrt(2 * w)
    return float(np.sum(2 * np.abs(np.diff(plane.s[index])) / np.maximum(v[1:] + v[:-1], _STILL)))


def _joined(plane: _Plane, index: np.ndarray, push: np.ndarray, goal: int, way: int, brake: np.ndarray | None):
    """Return a pushing leg up to where it crosses the braking leg into the goal, then that one; None without a crossing."""
    if brake is None or not (goal - index[0]) * way > 0:
        return None
    braking = np.full(len(plane.s), np.nan)
    braking[goal - way * np.arange(len(brake))] = brake
    ahead = np.arange(index[0], goal + way, way)
    pushing = np.full(len(plane.s), np.nan)
    pushing[index] = push
    over = np.flatnonzero(pushing[ahead] >= braking[ahead])
    if not len(over):
        return None
    k = int(over[0])
    # Below the braking leg just before, or the way there is not open: it would be met too fast.
    if np.any(np.isnan(pushing[ahead[:k]])) or (k and np.isnan(braking[ahead[k - 1]])):
        return None
    w = np.concatenate([pushing[ahead[:k]], braking[ahead[k:]]])
    effort = np.where(np.arange(len(ahead)) < k, way, -way)
    return ahead, w, effort


def _guess(plane: _Plane, legs, start_pose: np.ndarray) -> Guess:
    """Return legs as a guess: position and velocity by Hermite cubics over time, efforts as they push."""
    times, s, v, pushes = [0.0], [plane.s[legs[0][0][0]]], [], []
    for leg_number, (index, w, effort) in enumerate(legs):
        way = int(np.sign(index[-1] - index[0]))
        speed = way * np.sqrt(2 * w)
        step = np.abs(np.diff(plane.s[index]))
        times += list(times[-1] + np.cumsum(2 * step / np.maximum(np.abs(speed[1:] + speed[:-1]), _STILL)))
        s += list(plane.s[index[1:]])
        v += list(speed if leg_number == 0 else speed[1:])
        pushes += list(effort[:-1] * 1.0)
    t, pushed = np.array(times), np.array(pushes)
    path = CubicHermiteSpline(t, np.array(s)[:, None], np.array(v)[:, None])
    place = np.array(s)

    def effort_at(at: np.ndarray) -> np.ndarray:
        k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(pushed) - 1)
        half = 2 * np.clip(np.searchsorted(plane.s, place[k]), 0, len(plane.s) - 1)
        return np.where(pushed[k, None] > 0, plane.effort[+1][half], plane.effort[-1][half])

    switched = np.flatnonzero(np.diff(pushed)) + 1
    ends = np.concatenate([[0.0], t[switched], t[-1:]])
    return Guess(
        position=path,
        velocity=path.derivative(1),
        acceleration=path.derivative(2),
        effort=effort_at,
        duration_s=float(t[-1]),
        start_pose=start_pose,
        legs=len(legs),
        cuts_s=t[switched],
        held=effort_at(0.5 * (ends[1:] + ends[:-1])),
    )


def stretched(guess: Guess, duration: float) -> Guess:
    """Return a guess slowed or hastened to a duration, its efforts left to inverse dynamics."""
    factor = guess.duration_s / duration
    return Guess(
        position=lambda t: guess.position(factor * t),
        velocity=lambda t: factor * guess.velocity(factor * t),
        acceleration=lambda t: factor**2 * guess.acceleration(factor * t),
        effort=None,
        duration_s=duration,
        start_pose=guess.start_pose,
        legs=guess.legs,
    )
