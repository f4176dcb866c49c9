"""The reach of a mechanism: the interval of an independent joint on the home branch, and the reasons for its ends."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from linkplan.models.closure import newton
from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import RANGE_ROUNDING, beyond_balls
from linkplan.models.poses.assembly import advance, continue_to, in_loops, step_sizes, steps_to, strides
from linkplan.models.poses.period import returned, travel_scales, turn_of
from linkplan.models.poses.sign_change import sign_change
from linkplan.models.poses.singular_poses import (
    closure_rank,
    has_single_motion,
    is_singular,
    least_values,
    local_minima,
)
from linkplan.models.reduction.closing import rates_at
from linkplan.models.tree.joints import Joint

# Neighbours on either side in a spline of poses. Its error at steps of half a degree is below 1e-8.
_SPLINE_NEIGHBOURS = 5
# The reason given if nothing ends the reach. A slide, and a joint that moves one, is followed over so many model sizes.
_NO_END, _SLIDE_EXTENTS = "no end found", 20
# A hinge without a stop and without a period is followed over this many turns.
_MAX_TURNS = 100


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class End:
    """An end of the reach: the independent position there [rad or m] and the reason."""

    position: float
    # "range of A", "range of ball joint B", "end of rod_rx's chart", "singular pose",
    # "full turn", "20 turns" or "no end found"
    reason: str
    joint: int | None  # the coordinate whose range ends the reach
    stops: bool = True  # false if the joint goes on beyond it


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Reach:
    """The interval of one independent joint while the other independent joints stay at home.

    `poses` (n, n_q) samples the interval, ends included. If nothing stops the joint and the mechanism comes back, `period`
    is the travel [rad] after which it does. The interval is then a period to both sides of `home`; it `repeats` if the
    period above home has the poses of the one below. `singular` are positions where J_z loses rank: det J_z crosses zero at
    an end or touches zero on the way. `branching` are pairs (position, rank of the closure) at singular positions where J
    loses rank as well, so that the mechanism may branch. At the other singular positions only the coordinate is at a dead
    centre. `single` are branching positions through which only one motion passes to second order.
    """

    coordinate: int
    lower: End
    upper: End
    home: float
    period: float | None
    poses: np.ndarray
    repeats: bool
    singular: tuple[float, ...]
    branching: tuple[tuple[float, int], ...]
    single: tuple[float, ...]

    @property
    def poses_once(self) -> np.ndarray:
        """The poses without those that repeat others a period later."""
        return self.poses[len(self.poses) // 2 :] if self.repeats else self.poses

    @property
    def turns_fully(self) -> bool:
        """True if nothing stops the joint to either side, within a period or as far as it is followed."""
        return not (self.lower.stops or self.upper.stops)

    @property
    def once(self) -> tuple[float, float]:
        """The interval [rad or m] with every pose once: a period about home, or the whole reach."""
        if self.period is None:
            return self.lower.position, self.upper.position
        return self.home - self.period / 2, self.home + self.period / 2


@functools.lru_cache(maxsize=1024)
def reach(mechanism: Mechanism, coordinate: int = 0) -> Reach:
    """Return the reach of an independent joint on the home branch.

    It ends at the range of a joint or a ball joint, at a singular pose, or after a period.
    """
    up, upper, singular_up = _walk(mechanism, coordinate, +1)
    turned = _turned_back(mechanism, coordinate, up, upper)
    down, lower, singular_down = turned or _walk(mechanism, coordinate, -1)
    poses = np.array([*down[::-1], mechanism.home, *up])
    if travel_scales(mechanism)[coordinate] > 1.0:
        poses = _denser(mechanism, coordinate, poses, len(down))
    index = int(mechanism.independent[coordinate])
    turns = bool(in_loops(mechanism)[coordinate])
    touched = _touched(mechanism, coordinate, poses) if turns else []
    singular = sorted([*singular_down, *singular_up, *touched], key=lambda pose: pose[index])
    lost = [pose for pose in singular if closure_rank(mechanism, pose) < len(mechanism.dependent)]
    at_home = float(mechanism.home[index])
    repeated = not (lower.stops or upper.stops or _NO_END in (lower.reason, upper.reason))
    return Reach(
        coordinate=coordinate,
        lower=lower,
        upper=upper,
        home=at_home,
        period=upper.position - at_home if repeated else None,
        poses=poses,
        repeats=turned is not None,
        singular=tuple(float(pose[index]) for pose in singular),
        branching=tuple((float(pose[index]), closure_rank(mechanism, pose)) for pose in lost),
        single=tuple(float(pose[index]) for pose in lost if has_single_motion(mechanism, pose)),
    )


def _denser(mechanism: Mechanism, coordinate: int, poses: np.ndarray, home: int) -> np.ndarray:
    """Return the poses of a reach with further ones where a joint moves by more than half a step between two of them.

    The steps of a motor behind a gear are long where the mechanism moves slowly; `home` is the index of the home pose.
    """
    index, unit = int(mechanism.independent[coordinate]), step_sizes(mechanism) / 2
    parts = np.maximum(1, np.ceil(np.max(np.abs(np.diff(poses, axis=0)) / unit, axis=1) - 1e-9)).astype(int)
    places = [np.linspace(a, b, n + 1)[1:] for a, b, n in zip(poses[:-1, index], poses[1:, index], parts, strict=True)]
    sides = []
    for positions in (np.concatenate([[], *places[home:]]), np.concatenate([poses[:1, index], *places[:home]])[::-1][1:]):
        path = np.tile(mechanism.home[mechanism.independent], (len(positions), 1))
        path[:, coordinate] = positions
        sides.append(continue_to(mechanism, mechanism.home, path)[0][: len(path)])
    return np.array([*sides[1][::-1], mechanism.home, *sides[0]])


def _turned_back(mechanism: Mechanism, coordinate: int, up: list[np.ndarray], upper: End) -> tuple | None:
    """Return what `_walk` returns for the period below home if the one above leads back: the same poses, turned back.

    None if it has not, or if a range is left on the way.
    """
    turn = None if upper.stops or upper.reason == _NO_END else returned(mechanism, up[-1] - mechanism.home)
    if turn is None:
        return None
    below = np.array([*up[-2::-1], mechanism.home]) - turn
    ranges = np.array([(joint.lower, joint.upper) for joint in mechanism.joints])
    inside = (below >= ranges[:, 0] - RANGE_ROUNDING) & (below <= ranges[:, 1] + RANGE_ROUNDING)
    if not np.all(inside[:, turn != 0]):
        return None
    position = float(below[-1, mechanism.independent[coordinate]])
    return list(below), End(position=position, reason=upper.reason, joint=None, stops=False), []


def _touched(mechanism: Mechanism, coordinate: int, poses: np.ndarray) -> list[np.ndarray]:
    """Return the poses inside a reach at which J_z loses rank although no determinant changes sign."""
    import scipy

    index, found = int(mechanism.independent[coordinate]), []
    for k in local_minima(mechanism, poses):
        # Newton is ill-conditioned next to such a pose. The motion is smooth, so a spline of its neighbours is accurate.
        near = poses[max(0, k - _SPLINE_NEIGHBOURS) : k + _SPLINE_NEIGHBOURS + 1]
        motion = scipy.interpolate.CubicSpline(near[:, index], near)

        def least(x: float, motion=motion) -> float:
            return float(least_values(mechanism, motion(x))[1])

        ends = (float(poses[k - 1, index]), float(poses[k + 1, index]))
        x = scipy.optimize.minimize_scalar(least, bounds=ends, method="bounded", options={"xatol": 1e-12}).x
        if is_singular(mechanism, motion(x)):
            found.append(motion(x))
    return found


def _walk(mechanism: Mechanism, coordinate: int, sign: int) -> tuple[list[np.ndarray], End, list[np.ndarray]]:
    """Return the poses after home up to the end in one direction, the end, and the singular pose there, if any."""
    index = int(mechanism.independent[coordinate])
    joint, home = mechanism.joints[index], mechanism.home
    limit = joint.upper if sign > 0 else joint.lower
    turn = turn_of(mechanism, coordinate) if joint.kind == "hinge" else _SLIDE_EXTENTS * mechanism.extent_m
    poses: list[np.ndarray] = []
    if sign * (limit - home[index]) <= 0:  # home is at this end, or outside the range
        return poses, End(position=float(limit), reason=_end_of(joint), joint=index), []
    q = np.array(home)
    for turns in range(1, _MAX_TURNS + 1):
        last = home[index] + sign * turns * turn
        ends = sign * (limit - last) <= 0
        found, end, singular = _walk_to(mechanism, q, coordinate, float(limit) if ends else last)
        poses += found
        if end is not None:
            return poses, end, singular
        if ends:
            return poses, End(position=float(limit), reason=_end_of(joint), joint=index), []
        q = poses[-1]
        if joint.kind == "hinge" and returned(mechanism, q - home) is not None:
            travel = turns * turn / (2 * np.pi)
            reason = "full turn" if turns * turn == 2 * np.pi else f"{travel:.6g} turns"
            return poses, End(position=last, reason=reason, joint=None, stops=False), []
        if joint.kind == "slide" or _has_slid_far(mechanism, q):
            break
    return poses, End(position=float(q[index]), reason=_NO_END, joint=None, stops=False), []


def _has_slid_far(mechanism: Mechanism, pose: np.ndarray) -> bool:
    """Return True if a slide has moved by the largest distance that slides are followed."""
    slides = np.array([joint.kind == "slide" for joint in mechanism.joints])
    return bool(np.any(np.abs(pose - mechanism.home)[slides] >= (1 - 1e-9) * _SLIDE_EXTENTS * mechanism.extent_m))


def _walk_to(
    mechanism: Mechanism, q: np.ndarray, coordinate: int, last: float
) -> tuple[list[np.ndarray], End | None, list[np.ndarray]]:
    """Return the poses after q up to a position of the coordinate, and the end and singular pose on the way, if any."""
    index = int(mechanism.independent[coordinate])
    step, way = step_sizes(mechanism)[index] / 2, last - q[index]
    n_steps = int(np.ceil(abs(way) / step - 1e-9))
    path = np.tile(mechanism.home[mechanism.independent], (max(n_steps, 1), 1))
    path[:, coordinate] = q[index] + np.sign(way) * step * np.arange(1, len(path) + 1)
    path[-1, coordinate] = last
    poses: list[np.ndarray] = []
    begin, n = 0, 16  # ranges are checked after 16 steps, and then after four times as many each time
    while begin < len(path):
        found, arrived = continue_to(mechanism, q, path[begin : begin + n])
        outside = _leaves_ranges(mechanism, found)
        for trial, leaves in zip(found, outside, strict=True):
            stop = _range_stop(mechanism, q, trial, coordinate) if leaves.any() else None
            if stop is not None:
                poses.append(stop[0])
                return poses, End(position=float(stop[0][index]), reason=stop[1], joint=stop[2]), []
            poses.append(trial)
            q = trial
        if arrived < len(path[begin : begin + n]):
            pose = _singular_pose(mechanism, q, coordinate)
            return poses, End(position=float(pose[index]), reason="singular pose", joint=None), [pose]
        begin, n = begin + n, 4 * n
    return poses, None, []


def _end_of(joint: Joint) -> str:
    return f"range of {joint.name}" if joint.chart is None or joint.kind == "slide" else f"end of {joint.name}'s chart"


def _leaves_ranges(mechanism: Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return a mask (n, n_z + n_balls) of dependent joints and ball joints outside their ranges at poses (n, n_q)."""
    ranges = [(mechanism.joints[i].lower, mechanism.joints[i].upper) for i in mechanism.dependent]
    low, high = np.array(ranges).reshape(-1, 2).T
    z = poses[:, mechanism.dependent]
    return np.hstack([np.maximum(z - high, low - z), beyond_balls(mechanism, poses)]) > RANGE_ROUNDING


def _range_stop(mechanism: Mechanism, q: np.ndarray, trial: np.ndarray, coordinate: int):
    """Return the pose where the first range is left between two poses, the reason and the joint's index, or None."""
    (out,) = _leaves_ranges(mechanism, trial[None])
    joints, stops = mechanism.dependent, []
    for i in joints[out[: len(joints)]]:
        stops.append((*_joint_end(mechanism, trial, i), _end_of(mechanism.joints[i]), int(i)))
    for k in np.flatnonzero(out[len(joints) :]):
        reason = f"range of ball joint {mechanism.balls[k].name}"
        stops.append((lambda p, k=k: float(beyond_balls(mechanism, p[None])[0, k]), 1.0, reason, None))
    first, index = None, mechanism.independent[coordinate]
    for beyond, unit, reason, joint in stops:
        # A joint that does not move with the coordinate, or that returns into its range, is no stop.
        if not beyond(trial) - beyond(q) > ROUNDING_SHARE * unit:
            continue
        pose = _pose_where(mechanism, q, trial, coordinate, beyond)
        distance = abs(pose[index] - q[index])
        if first is None or distance < first[3]:
            first = (pose, reason, joint, distance)
    return first if first is None else first[:3]


def _joint_end(mechanism: Mechanism, trial: np.ndarray, i: int) -> tuple[Callable[[np.ndarray], float], float]:
    """Return how far a pose is beyond the end of a joint's range that `trial` has left, as a function, and its unit."""
    upper, lower = mechanism.joints[i].upper, mechanism.joints[i].lower
    above = trial[i] > upper
    return (lambda p: float(p[i] - upper if above else lower - p[i])), float(step_sizes(mechanism)[i])


def _pose_where(mechanism: Mechanism, q: np.ndarray, trial: np.ndarray, coordinate: int, function) -> np.ndarray:
    """Return the pose between two poses at which `function(pose)` changes sign, or the first pose if it does not."""
    index = mechanism.independent[coordinate]
    a, b = float(q[index]), float(trial[index])
    known = [np.array(q)]

    def at(x: float) -> np.ndarray:
        nearest = min(known, key=lambda pose: abs(pose[index] - x))
        s = nearest[mechanism.independent].copy()
        s[coordinate] = x
        known.append(advance(mechanism, nearest, s)[0])  # the last pose before the loop opens, if it does
        return known[-1]

    if function(q) * function(trial) >= 0 or function(q) * function(at(b)) >= 0:
        return np.array(q)
    return at(sign_change(lambda x: function(at(x)), a, b, xtol=1e-11))


def _singular_pose(mechanism: Mechanism, near: np.ndarray, coordinate: int) -> np.ndarray:
    """Return the closed pose with det J_z = 0 next to `near`, or `near` itself if there is none within four steps.

    The closed poses form a curve if the other independent coordinates stand still. The distance along its tangent at `near`
    describes the curve also beyond a pose at which the coordinate turns back (pseudo-arclength continuation: Keller 1977).
    """
    dynamics, unit = mechanism.dynamics, step_sizes(mechanism)
    free = [*[int(i) for i in mechanism.dependent], int(mechanism.independent[coordinate])]
    at_home, here = (np.array(dynamics.block_singularity(q)).ravel() for q in (mechanism.home, near))
    at_home = np.where(at_home == 0, 1.0, at_home)
    block = int(np.argmin(np.abs(here / at_home)))  # the loops that fold
    tangent = np.zeros(len(near))
    tangent[free] = np.linalg.svd((np.array(dynamics.closure_jacobian(near)) * unit)[:, free])[2][-1]

    def along(distance: float) -> np.ndarray:
        def residual(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            phi, jacobian = np.array(dynamics.closure(q)).ravel(), np.array(dynamics.closure_jacobian(q))
            return np.append(phi, tangent @ ((q - near) / unit) - distance), np.vstack([jacobian, tangent / unit])

        return newton.root_by_newton(residual, near + distance * unit * tangent, free)[0]

    def fold(distance: float) -> float:
        q = along(distance)
        values = dynamics.orientation(near, q) if mechanism.projected else dynamics.block_singularity(q)
        return float(values[block]) * np.sign(here[block])

    if fold(0.0) <= 0:  # rounding of the file leaves the loops of `near` too open to tell its side
        return np.array(near)
    way = 1.0 if fold(0.1) < fold(-0.1) else -1.0
    begin = 0.0
    for end in (0.5, 1.0, 2.0, 4.0):
        if fold(way * end) <= 0:
            pose = along(way * sign_change(lambda x: fold(way * x), begin, end, xtol=1e-11))
            gap = np.abs(np.array(dynamics.closure(pose))).max()
            return pose if gap < max(1e-8, mechanism.closed_m) else np.array(near)
        begin = end
    return np.array(near)


@functools.lru_cache(maxsize=1024)
def toggles(mechanism: Mechanism, coordinate: int = 0) -> tuple[tuple[int, float], ...]:
    """Return the dead centres (joint, independent position) in a reach: where rates of dependent joints change sign."""
    if not in_loops(mechanism)[coordinate]:
        return ()
    poses = reach(mechanism, coordinate).poses
    found = _turning_points(mechanism, coordinate, poses)
    fast = {gap for gap, _, position in found if np.isnan(position)}
    if fast:  # near a singular pose, where no single stride joins two poses: those between them are needed too
        parts = [[pose] for pose in poses]
        for gap in fast:
            parts[gap] += steps_to(mechanism, poses[gap], poses[gap + 1, mechanism.independent])
        poses = np.array([pose for part in parts for pose in part])
        found = _turning_points(mechanism, coordinate, poses)
    turning = [
        (joint, _turning_point(mechanism, coordinate, poses[k : k + 2], joint) if np.isnan(position) else position)
        for k, joint, position in found
    ]
    return tuple(sorted(turning, key=lambda item: item[1]))


def _turning_point(mechanism: Mechanism, coordinate: int, ends: np.ndarray, joint: int) -> float:
    """Return the independent position where a joint's rate changes sign between two poses (2, n_q)."""

    def rate(pose: np.ndarray) -> float:
        return float(rates_at(mechanism.dynamics, pose[None], coordinate)[0, joint])

    return float(_pose_where(mechanism, ends[0], ends[1], coordinate, rate)[mechanism.independent[coordinate]])


def _turning_points(mechanism: Mechanism, coordinate: int, poses: np.ndarray) -> list[tuple[int, int, float]]:
    """Return (number of the pose before, joint, independent position) where a dependent joint's rate changes sign.

    The position is NaN if no single stride leads there from the pose before.
    """
    index, found, between = mechanism.independent[coordinate], [], []
    rates = rates_at(mechanism.dynamics, poses, coordinate)
    rates[np.abs(rates) < ROUNDING_SHARE] = 0.0
    for joint in mechanism.dependent.tolist():
        moving = np.flatnonzero(rates[:, joint]).tolist()  # the rate at a dead centre itself has no sign
        for before, after in pairwise(moving):
            if rates[before, joint] * rates[after, joint] > 0:
                continue
            if after > before + 1:
                found.append((before, joint, float(poses[(before + after) // 2, index])))
            else:
                between.append((before, joint))
    if not between:
        return found
    gaps, joints = np.array(between).T

    def rate(x: np.ndarray) -> np.ndarray:
        s = poses[gaps][:, mechanism.independent]
        s[:, coordinate] = x
        there = strides(mechanism, poses[gaps], s)
        return rates_at(mechanism.dynamics, there, coordinate)[np.arange(len(gaps)), joints]

    places = sign_change(rate, poses[gaps, index], poses[gaps + 1, index], xtol=1e-11)
    return [*found, *zip(gaps.tolist(), joints.tolist(), places.tolist(), strict=True)]
