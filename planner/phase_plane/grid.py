"""The phase plane's grid over one degree of freedom: the positions of a motion, and the work done between them.

Cells are shorter near a singular pose, where some joints move fast relative to the coordinate s.
"""

from dataclasses import dataclass
from math import inf, sqrt

import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.models.external_forces import loads_of
from linkplan.models.poses.along import sampled, sliding_friction
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.period import turn_of
from linkplan.models.poses.reach import reach
from linkplan.planner.limits.joints import bounds_of_state
from linkplan.planner.limits.kinds import affine_limits, effort_bounds, kept_at
from linkplan.planner.limits.samples import singularity_ratios
from linkplan.planner.problem.problem import Problem

# How far a crank that turns fully may go beyond start and goal [rad].


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PhasePlane:
    """A grid over s: positions (n,) of cell ends, the reduced inertia there, and the work of the efforts up to there.

    d(M w)/ds = dW[direction]/ds + drag v - rub along the motion, which is exact unless dampers are nonlinear.
    """

    s: np.ndarray
    cells: np.ndarray  # widths (n - 1,)
    inertia: np.ndarray  # M
    work: dict[int, np.ndarray]  # W of weight, springs and full effort in direction +1 or -1, from the first position
    force: dict[int, np.ndarray]  # dW/ds
    drag: np.ndarray  # M da/dv
    rub: np.ndarray  # dry friction
    top: dict[int, np.ndarray]  # largest w in either direction from which full effort keeps the speed limits further on
    effort: dict[int, np.ndarray]  # (2 n - 1, n_u) that pushes so, at ends and middles in turn

    @property
    def undamped(self) -> bool:
        """True if neither dampers nor dry friction dissipate energy anywhere."""
        return not np.any(self.drag) and not np.any(self.rub)

    def at(self, place: float) -> int:
        """Return the index of the cell end at a position."""
        return int(np.argmin(np.abs(self.s - place)))

    def leg(
        self, start: int, w: float, step: int, effort: int, *, backwards: bool = False, below: np.ndarray | None = None
    ) -> np.ndarray:
        """Return w at the cell ends from index `start` on, in steps of +1 or -1, until w would fall to zero or below.

        `effort` is the direction of the effort. With `backwards` the motion runs against the steps: a braking leg, computed
        from its end. `below` (n,) are upper bounds of w at the cell ends.
        """
        sign = -step if backwards else step
        if not w and step * (self.force[effort][start] - sign * self.rub[start]) <= 0:
            return np.array([float(w)])  # rest cannot be left in this direction, even if the way is open a little further on
        if self.undamped:
            return self._free_leg(start, w, step, effort, self.top[sign], below)
        # In plain floats: place by place, numpy's take ten times as long.
        inertia, drags, rub, top, work, cells = (
            x.tolist() for x in (self.inertia, self.drag, self.rub, self.top[sign], self.work[effort], self.cells)
        )
        at, n, values, energy = start, len(inertia), [float(w)], inertia[start] * w
        while 0 <= at + step < n:
            over = at + step
            h = cells[at] if step > 0 else -cells[over]
            drag = sign * (drags[at] * sqrt(2 * w) - rub[at])
            free = energy + work[over] - work[at]
            ahead = max(free + h * drag, 0.0) / inertia[over]
            energy = free + 0.5 * h * (drag + sign * (drags[over] * sqrt(2 * ahead) - rub[over]))
            if energy <= 0 or top[over] <= 0:
                break
            at, w = over, min(energy / inertia[over], top[over], inf if below is None else float(below[over]))
            energy = inertia[at] * w
            values.append(w)
        return np.array(values)

    def _free_leg(
        self, start: int, w: float, step: int, effort: int, top: np.ndarray, below: np.ndarray | None
    ) -> np.ndarray:
        """Return the same as `leg` without dampers: the work gives the energy, limited by the largest w of each position.

        E_k = min(E_0 + W_k - W_0, min over places j on the way of (top E_j + W_k - W_j)).
        """
        if not start and step < 0:
            return np.array([float(w)])
        ahead = slice(start + step, None, step)
        inertia, work, top = self.inertia[ahead], self.work[effort][ahead], top[ahead]
        free = self.inertia[start] * w - self.work[effort][start]
        least = np.full(len(inertia), free)
        most = top if below is None else np.minimum(top, below[ahead])
        if np.any(np.isfinite(most)):
            least = np.minimum(least, np.minimum.accumulate(inertia * most - work))
        # A place's limit restricts the energy from the next place on. A leg ends where its energy ends, or where no motion
        # may pass.
        before = np.concatenate([[free], least[:-1]])
        stops = np.flatnonzero((before + work <= 0) | (top <= 0))
        n = int(stops[0]) if len(stops) else len(inertia)
        return np.concatenate([[float(w)], (least[:n] + work[:n]) / inertia[:n]])


def grid_of(
    problem: Problem, places: np.ndarray, start_pose: np.ndarray, n_cells: int, *, graded: bool = True
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return positions (n,) around the places that a motion passes, within the joints' ranges, and the poses there.

    The poses (2 n - 1, n_q) are at the grid points and midway between them. None if a position that is out of range
    separates one of the places from the others, or if a load over a speed changes the efforts along the motion.

    Args:
        problem: a problem of one degree of freedom.
        places: positions that become cell ends, the start first.
        start_pose: the closed pose at the start.
        n_cells: number of cells of the grid over s, with two poses per cell.
        graded: whether cells are closer together where joints or the inertia change most.
    """
    mechanism, limits = problem.mechanism, problem.limits
    if any(load.over == "speed" for load in loads_of(mechanism.model)):
        return None
    ends = np.array([places.min(), places.max()])
    can = reach(mechanism)
    low, high = bounds_of_state(problem)[0][0]
    if can.turns_fully:
        # How far other unlimited joints may go beyond them, in distances between start and goal.
        beyond = max(can.period or turn_of(mechanism, 0), 1.5 * float(ends[1] - ends[0]))
        low, high = max(low, ends[0] - beyond), min(high, ends[1] + beyond)
    else:
        low, high = max(low, can.lower.position), min(high, can.upper.position)
    # The distance of the grid from the ends of the reach, as a share of the reach. The least time of a motion that turns
    # back next to a singular pose falls by a third from a thousandth of the reach to a hundred-thousandth.
    room = [1e-5 if end.reason == "singular pose" else 1e-3 for end in (can.lower, can.upper)]
    low, high = low + room[0] * (high - low), high - room[1] * (high - low)
    s = np.linspace(min(low, ends[0]), max(high, ends[1]), n_cells + 1)
    gridded = _followed(problem, s, places, start_pose)
    if gridded is None:
        return None
    s, poses = gridded
    s, poses = _around(places[0], s, poses, kept_at(problem, poses))
    if not _holds(s, ends):
        return None
    if graded:
        gridded = _followed(problem, _graded(problem, s, poses[::2]), places, start_pose)
        if gridded is None:
            return None
        s, poses = gridded
    if limits.singular_margin:
        s, poses = _around(places[0], s, poses, singularity_ratios(problem.mechanism, poses) >= limits.singular_margin)
    return (s, poses) if _holds(s, ends) else None


def _around(place: float, s: np.ndarray, poses: np.ndarray, within: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest part of a grid around a place with `within` (2 n - 1,) true at all its poses."""
    begin, out = 2 * int(np.argmin(np.abs(s - place))), np.flatnonzero(~within)
    first = (int(out[out < begin].max(initial=-1)) + 2) // 2
    last = (int(out[out > begin].min(initial=len(poses))) - 1) // 2
    return s[first : last + 1], poses[2 * first : 2 * last + 1]


def _holds(s: np.ndarray, ends: np.ndarray) -> bool:
    """Return True if a grid has cells and contains the lowest and the highest place that a motion passes."""
    return len(s) >= 3 and bool(s[0] <= ends[0] <= ends[1] <= s[-1])


def _followed(problem: Problem, s: np.ndarray, places: np.ndarray, start_pose: np.ndarray):
    """Return positions (n,) that include the places, and the poses (2 n - 1, n_q) at and between them.

    None if the kinematic loops cannot be closed at one of the positions.
    """
    room = 1e-9 * (s[-1] - s[0])
    apart = np.all(np.abs(s[:, None] - places) > room, axis=1)
    s = np.unique(np.concatenate([s[apart], places]))
    fine = np.interp(np.arange(2 * len(s) - 1) / 2, np.arange(len(s)), s)
    begin = int(np.argmin(np.abs(fine - places[0])))
    try:
        after = follow(problem.mechanism, fine[begin:, None], start_pose, problem.solver.deadline)
        before = follow(problem.mechanism, fine[begin::-1, None], start_pose, problem.solver.deadline)[::-1]
    except AssemblyError:
        return None
    return s, np.vstack([before[:-1], after])


def _graded(problem: Problem, s: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Return positions (n,) between the same ends, spread half evenly and half by the changes of pose and inertia."""
    inertia = sampled(problem.mechanism.dynamics.reduced_inertia, poses)[:, 0, 0]
    steps = np.abs(np.diff(np.column_stack([poses, np.log(inertia)]), axis=0))
    share = (steps / np.maximum(steps.sum(axis=0), np.finfo(float).tiny)).mean(axis=1)
    share = 0.5 * share / share.sum() + 0.5 * np.diff(s) / (s[-1] - s[0])
    progress = np.concatenate([[0.0], np.cumsum(share)])
    return np.interp(np.linspace(0.0, progress[-1], len(s)), progress, s)


def plane_of(problem: Problem, s: np.ndarray, poses: np.ndarray, *, share: float = 1.0) -> PhasePlane:
    """Return the plane over a grid's positions (n,) and poses (2 n - 1, n_q), with a share of the efforts' bounds."""
    dynamics, n, limit = problem.mechanism.dynamics, len(poses), share * effort_bounds(problem)

    def acceleration(v: float, u: np.ndarray) -> np.ndarray:
        return sampled(dynamics.acceleration, poses, np.full((n, 1), v), u)[:, 0, 0]

    inertia = sampled(dynamics.reduced_inertia, poses)[:, 0, 0]
    none = np.zeros((n, len(limit)))
    ahead, back, still = (acceleration(v, none) for v in (1.0, -1.0, 0.0))
    maps = sampled(dynamics.effort_map, poses)[:, 0]
    effort = {way: np.where(way * maps > 0, limit[:, 1], limit[:, 0]) for way in (+1, -1)}
    force = {way: inertia * still + (maps * u).sum(axis=1) for way, u in effort.items()}
    gains = {way: np.diff(s) * (f[:-2:2] + 4 * f[1::2] + f[2::2]) / 6 for way, f in force.items()}
    works = {way: np.concatenate([[0.0], np.cumsum(gain)]) for way, gain in gains.items()}
    rub = sliding_friction(problem.mechanism, poses)
    # The largest w = v^2 / 2 that satisfies all limits on speeds.
    ratios, bounds = speed_ratios(problem, poses[::2])
    ratio, speed = np.abs(ratios), np.abs(bounds).min(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        fastest = 0.5 * np.where(ratio > 0, speed / ratio, np.inf).min(axis=1, initial=np.inf) ** 2
    return PhasePlane(
        s=s,
        cells=np.diff(s),
        inertia=inertia[::2],
        work=works,
        force={way: f[::2] for way, f in force.items()},
        drag=_drag(0.5 * inertia * (ahead - back), rub)[::2],
        rub=rub[::2],
        top={way: _kept(fastest, inertia[::2], works[-way], way) for way in effort},
        effort=effort,
    )


def _drag(both: np.ndarray, rub: np.ndarray) -> np.ndarray:
    """Return M da/dv (n,) of the dampers, from the efforts of dampers and dry friction at unit speed in both directions."""
    if not rub.any():
        return both
    damped = np.minimum(both + rub, 0.0)
    # A difference of two frictions below this share of them is rounding, or the smooth transition at low speeds.
    return np.where(damped < -1e-6 * rub, damped, 0.0)


def speed_ratios(problem: Problem, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the quantities of limits on speeds per unit of speed (n, n_limits) at poses (n, n_q), and their [low, high]."""
    limited, ones = affine_limits(problem, of_speed=True), np.ones((len(poses), 1))
    ratios = [one.value(poses, ones, 0.0 * ones, 0.0 * ones) for one in limited]
    return np.concatenate([np.empty((len(poses), 0)), *ratios], axis=1), np.array([one.bounds for one in limited]).reshape(
        -1, 2
    )


def _kept(fastest: np.ndarray, inertia: np.ndarray, braking: np.ndarray, way: int) -> np.ndarray:
    """Return the largest w (n,) from which a motion that brakes can satisfy the speed limits further on.

    Args:
        fastest: (n,) the largest w that the speed limits allow at each position.
        inertia: (n,) the reduced inertia there.
        braking: (n,) the work of weight and full braking effort up to there.
        way: the direction of motion, +1 or -1.
    """
    energy = inertia * fastest
    if np.all(np.isinf(energy)):
        return energy
    kept, spent = energy.tolist(), braking.tolist()  # in plain floats: place by place, numpy's take ten times as long
    order = range(len(kept) - 2, -1, -1) if way > 0 else range(1, len(kept))
    for k in order:
        kept[k] = max(min(kept[k], kept[k + way] - (spent[k + way] - spent[k])), 0.0)
    return np.array(kept) / inertia
