"""Poses of a mechanism on its branch: along a path of independent positions, and as far as the chain reaches.

A path is followed by a tangent predictor and Newton in the dependent joints. Where Newton fails, corrects by more than
the step itself, or the sign of a block of det J_z turns, the step is halved: so a pose found is on the branch that the path
began on, and a path that meets a singular pose stops there instead of slipping through.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.interpolate
import scipy.optimize

from linkplan.models.closure.newton import CLOSED_M
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled
from linkplan.models.poses.singular_poses import closure_rank, dips, has_one_way_on, is_branching, least_values, vanishes
from linkplan.models.tree.joints import Joint, where

_STEP = 0.035  # two degrees [rad]; on a slide, this share of the model's extent
_MIN_SHARE = 1e-5  # of a step: shorter than this, the path has met a singular pose
_NEWTON_STEPS = 12
# A pose further away than this many steps (some 500 turns) is taken for a typing error.
_MOST_STEPS = 1e5
# A rate of a dependent joint below this share of the independent one's is rounding.
_STILL = 1e-9
# A range is left where a joint stands outside it by more than this [rad or m], what assembly and rounding leave.
_RANGE_SLACK = 1e-8
# Neighbours to either side of a spline of poses: with these its error at half degree steps is below 1e-8.
_SPLINED = 5
# Paths of more samples than this are solved together.
_FEWEST_AT_ONCE = 20


def follow(mechanism: Mechanism, path: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
    """Return the poses (n, n_q) on the branch of `start` along positions s of the independent joints (n, n_s).

    Args:
        mechanism: whose loops are to stay closed.
        path: independent positions [rad or m], each near the one before; the first may be far from `start`.
        start: a closed pose (n_q,); home by default.

    Raises:
        AssemblyError: naming the joint's position at which the loop opens, or the ball joint whose chart the motion leaves.
    """
    poses = _followed(mechanism, path, start)
    left = mechanism.coordinates.left(poses)
    if left is not None:
        raise AssemblyError(f"mechanism '{mechanism.name}' turns {left}")
    return poses


def _followed(mechanism: Mechanism, path: np.ndarray, start: np.ndarray | None) -> np.ndarray:
    q = np.array(mechanism.home if start is None else start, dtype=float)
    path = np.asarray(path, dtype=float)
    if len(path) > _FEWEST_AT_ONCE:
        poses = _follow_at_once(mechanism, path, q)
        if poses is not None:
            return poses
    poses = np.empty((len(path), mechanism.n_q))
    for k, s in enumerate(path):
        q, arrived = _advance(mechanism, q, s)
        if not arrived:
            raise AssemblyError(
                f"mechanism '{mechanism.name}' does not close at {_where(mechanism, s)}: the kinematic loop opens at"
                f" {_where(mechanism, q[mechanism.independent])}"
            )
        poses[k] = q
    return poses


def _follow_at_once(mechanism: Mechanism, path: np.ndarray, q: np.ndarray) -> np.ndarray | None:
    """Return the poses along a path by Newton on all samples together, or None where that is not beyond doubt.

    Knots are followed one by one; the samples between two knots start from the straight line between them, which at half a
    step is well within Newton's reach of the same branch.
    """
    independent, dependent = mechanism.independent, mechanism.dependent
    step_size = _step_sizes(mechanism)
    travelled = np.max(np.abs(np.diff(path, axis=0)) / step_size[independent], axis=1, initial=0.0)
    at = np.concatenate([[0.0], np.cumsum(travelled)])
    if not at[-1] < _MOST_STEPS:
        return None
    knots = np.unique(np.concatenate([np.searchsorted(at, np.arange(0.0, at[-1], 0.5)), [len(path) - 1]]))
    if len(knots) > len(path) // 2:
        return None
    at_knots = np.empty((len(knots), mechanism.n_q))
    for row, k in enumerate(knots):
        q, arrived = _advance(mechanism, q, path[k])
        if not arrived:
            return None
        at_knots[row] = q
    poses = np.empty((len(path), mechanism.n_q))
    poses[:, independent] = path
    for joint in dependent:
        poses[:, joint] = np.interp(at, at[knots], at_knots[:, joint])
    predicted = poses[:, dependent].copy()
    many = mechanism.dynamics.closure_step.map(len(path))
    for _ in range(_NEWTON_STEPS):
        phi, steps, _, determinants = (np.array(x) for x in many(poses.T))
        if not np.all(np.isfinite(steps)):
            return None
        poses[:, dependent] += steps.T
        if np.abs(phi).max(initial=0.0) <= CLOSED_M and np.abs(steps).max(initial=0.0) < 1e-12:
            break
    else:
        return None
    moved = np.max(np.abs(poses[:, dependent] - predicted) / step_size[dependent], initial=0.0)
    if mechanism.projected and not _stays_on_branch(mechanism, poses):
        return None
    by_block = determinants.reshape(-1, len(path))
    one_sign = np.all(np.all(by_block > 0, axis=1) | np.all(by_block < 0, axis=1))
    return poses if moved < 0.25 and one_sign else None


def _stays_on_branch(mechanism: Mechanism, poses: np.ndarray) -> bool:
    """Return whether all rows of overconstrained loops are closed at poses (n, n_q), and no block folds between two."""
    if np.any(mechanism.gaps_m(poses) > mechanism.closed_m):
        return False
    turned = sampled(mechanism.dynamics.orientation, poses[:-1], poses[1:]) if len(poses) > 1 else np.ones(1)
    return bool(np.all(turned > 0))


def close_at(mechanism: Mechanism, s: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
    """Return the pose (n_q,) at independent positions s (n_s,), reached from `start` (home by default) on its branch."""
    return follow(mechanism, np.atleast_2d(np.asarray(s, dtype=float)), start)[0]


def _where(mechanism: Mechanism, s: np.ndarray) -> str:
    return where(mechanism.joints, dict(zip(mechanism.independent.tolist(), s.tolist(), strict=True)))


def _step_sizes(mechanism: Mechanism) -> np.ndarray:
    extent = mechanism.extent_m
    return np.array([_STEP if joint.kind == "hinge" else _STEP * extent for joint in mechanism.joints])


def _advance(mechanism: Mechanism, q: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, bool]:
    """Return the pose at `target`, or the last one on the branch before the loop comes apart, and whether it arrived."""
    independent, dependent = mechanism.independent, mechanism.dependent
    step_size = _step_sizes(mechanism)
    q = np.array(q, dtype=float)
    _, _, gamma, determinants = (np.array(x) for x in mechanism.dynamics.closure_step(q))
    share = 1.0
    longest = np.max(np.abs(target - q[independent]) / step_size[independent], initial=0.0)
    if not longest < _MOST_STEPS:
        raise AssemblyError(
            f"mechanism '{mechanism.name}' does not close at {_where(mechanism, target)}: further away than any motion goes"
        )
    while True:
        left = target - q[independent]
        longest = np.max(np.abs(left) / step_size[independent], initial=0.0)
        if longest == 0.0:
            return q, True
        fraction = min(1.0, share / longest)
        ds = left if fraction == 1.0 else fraction * left
        trial = q + gamma @ ds
        trial[independent] = target if fraction == 1.0 else q[independent] + ds
        predicted = trial[dependent].copy()
        trial, gamma_trial, dets_trial = _correct(mechanism, trial)
        moved = np.max(np.abs(trial[dependent] - predicted) / step_size[dependent], initial=0.0)
        turned = np.max(np.abs(gamma_trial - gamma), initial=0.0) > 0.5 * (1 + np.max(np.abs(gamma), initial=0.0))
        regular = np.isfinite(moved) and moved < 0.25 and not turned and np.all(dets_trial * determinants > 0)
        if regular and (not mechanism.projected or _stays_on_branch(mechanism, np.array([q, trial]))):
            q, gamma, determinants = trial, gamma_trial, dets_trial
            share = min(1.0, 2 * share)
            continue
        share = 0.5 * min(share, longest)
        if share < _MIN_SHARE:
            return q, False


def _correct(mechanism: Mechanism, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the pose closed by Newton in its dependent joints, with Gamma and det J_z by blocks; NaN where it fails."""
    q = np.array(q)
    dependent = mechanism.dependent
    for iteration in range(_NEWTON_STEPS):
        phi, step, gamma, determinants = mechanism.dynamics.closure_step(q)
        step = np.array(step).ravel()
        size = np.abs(step).max(initial=0.0)
        if not np.isfinite(size) or size > 10:
            break
        # One step past convergence costs little and leaves rounding only.
        done = np.abs(np.array(phi)).max(initial=0.0) <= CLOSED_M and (size < 1e-12 or iteration > 2)
        q[dependent] += step
        if done or step.size == 0:
            return q, np.array(gamma), np.array(determinants)
    return np.full_like(q, np.nan), np.full((mechanism.n_q, mechanism.dof), np.nan), np.array(np.nan)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class End:
    """Where the reach ends: the independent position there [rad or m], and why in a few words."""

    position: float
    reason: str  # "range of A", "end of rod_rx's chart", "singular pose", "full turn"
    joint: int | None  # whose range it is


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Reach:
    """What one independent joint can do while the other independent joints stay at home.

    `poses` (n, n_q) samples the interval, ends included. `toggles` are (dependent joint, independent position) where a
    dependent joint turns back: the dead centres of that joint. `singular` are positions where J_z loses rank, by crossing
    zero at an end or by touching it on the way; `branching` are (position, rank of the closure there) of those among them
    where J loses rank as well: there the mechanism may branch, at the others the coordinate alone is at a dead centre.
    `single` are positions of those where to second order one motion alone leads through.
    """

    coordinate: int
    lower: End
    upper: End
    poses: np.ndarray
    singular: tuple[float, ...]
    branching: tuple[tuple[float, int], ...]
    single: tuple[float, ...]
    toggles: tuple[tuple[int, float], ...]

    @property
    def turns_fully(self) -> bool:
        """Whether nothing stops the joint within a turn to either side."""
        return self.lower.reason == self.upper.reason == "full turn"


def reach(mechanism: Mechanism, coordinate: int = 0) -> Reach:
    """Return the interval of an independent joint on the home branch: to a joint's range, a singular pose, or a turn."""
    down, lower, singular_down = _walk(mechanism, coordinate, -1)
    up, upper, singular_up = _walk(mechanism, coordinate, +1)
    poses = np.array([*down[::-1], mechanism.home, *up])
    index = int(mechanism.independent[coordinate])
    singular = sorted([*singular_down, *singular_up, *_touched(mechanism, coordinate, poses)], key=lambda pose: pose[index])
    lost = [pose for pose in singular if is_branching(mechanism, pose)]
    return Reach(
        coordinate=coordinate,
        lower=lower,
        upper=upper,
        poses=poses,
        singular=tuple(float(pose[index]) for pose in singular),
        branching=tuple((float(pose[index]), closure_rank(mechanism, pose)) for pose in lost),
        single=tuple(float(pose[index]) for pose in lost if has_one_way_on(mechanism, pose)),
        toggles=_toggles(mechanism, coordinate, poses),
    )


def _touched(mechanism: Mechanism, coordinate: int, poses: np.ndarray) -> list[np.ndarray]:
    """Return the poses inside a reach at which J_z loses rank though no determinant changes sign."""
    index, found = int(mechanism.independent[coordinate]), []
    for k in dips(mechanism, poses):
        # Next to such a pose Newton has no ground; the motion is smooth, and a spline of its neighbours exact enough.
        near = poses[max(0, k - _SPLINED) : k + _SPLINED + 1]
        motion = scipy.interpolate.CubicSpline(near[:, index], near)

        def least(x: float, motion: scipy.interpolate.CubicSpline = motion) -> float:
            return float(least_values(mechanism, motion(x))[1])

        ends = (float(poses[k - 1, index]), float(poses[k + 1, index]))
        x = scipy.optimize.minimize_scalar(least, bounds=ends, method="bounded", options={"xatol": 1e-12}).x
        if vanishes(mechanism, motion(x)):
            found.append(motion(x))
    return found


def _at(mechanism: Mechanism, start: np.ndarray, coordinate: int, x: float) -> np.ndarray:
    """Return the pose where one coordinate stands at x, led there from `start`; the last one before where it cannot."""
    s = start[mechanism.independent].copy()
    s[coordinate] = x
    return _advance(mechanism, start, s)[0]


def _walk(mechanism: Mechanism, coordinate: int, sign: int) -> tuple[list[np.ndarray], End, list[np.ndarray]]:
    """Return the poses from home (left out) to the end in one direction, the end, and a singular pose if one."""
    index = int(mechanism.independent[coordinate])
    joint = mechanism.joints[index]
    step = _step_sizes(mechanism)[index] / 2
    turn = 2 * np.pi if joint.kind == "hinge" else 20 * mechanism.extent_m
    home = mechanism.home
    limit = joint.upper if sign > 0 else joint.lower
    last = limit if abs(limit - home[index]) <= turn else home[index] + sign * turn
    poses, q = [], np.array(home)
    if sign * (last - q[index]) <= 0:
        return poses, End(position=float(q[index]), reason=_end_of(joint), joint=index), []
    while True:
        target = q[index] + sign * step
        final = sign * (target - last) >= -1e-9
        s = q[mechanism.independent].copy()
        s[coordinate] = last if final else target
        trial, arrived = _advance(mechanism, q, s)
        stop = _range_stop(mechanism, q, trial, coordinate)
        if stop is not None:
            poses.append(stop[0])
            return poses, End(position=float(stop[0][index]), reason=_end_of(stop[1]), joint=stop[2]), []
        if not arrived:
            pose = _singular_pose(mechanism, trial, coordinate)
            poses.append(trial)
            return poses, End(position=float(pose[index]), reason="singular pose", joint=None), [pose]
        poses.append(trial)
        q = trial
        if final:
            reason = "full turn" if last != limit else _end_of(joint)
            return poses, End(position=float(last), reason=reason, joint=index if last == limit else None), []


def _end_of(joint: Joint) -> str:
    return f"range of {joint.name}" if joint.chart is None or joint.kind == "slide" else f"end of {joint.name}'s chart"


def _range_stop(mechanism: Mechanism, q: np.ndarray, trial: np.ndarray, coordinate: int):
    """Return the pose, joint and index where the first dependent joint leaves its range between two poses, or None."""
    first = None
    for i in mechanism.dependent:
        joint = mechanism.joints[i]
        for limit, outside in ((joint.upper, trial[i] - joint.upper), (joint.lower, joint.lower - trial[i])):
            outward = trial[i] - q[i] if limit == joint.upper else q[i] - trial[i]
            # A joint that does not move with the coordinate, or comes back into its range, does not stop it.
            if not outside > _RANGE_SLACK or not outward > _STILL * _step_sizes(mechanism)[i]:
                continue
            pose = _pose_where(mechanism, q, trial, coordinate, lambda p, i=i, limit=limit: p[i] - limit)
            distance = abs(pose[mechanism.independent[coordinate]] - q[mechanism.independent[coordinate]])
            if first is None or distance < first[3]:
                first = (pose, joint, int(i), distance)
    return first if first is None else first[:3]


def _pose_where(mechanism: Mechanism, q: np.ndarray, trial: np.ndarray, coordinate: int, function) -> np.ndarray:
    """Return the pose between two poses at which `function(pose)` changes sign (the start if it does not)."""
    index = mechanism.independent[coordinate]

    def pose_at(x: float) -> np.ndarray:
        return _at(mechanism, q, coordinate, x)

    a, b = q[index], trial[index]
    if function(q) * function(trial) >= 0 or function(pose_at(a)) * function(pose_at(b)) >= 0:
        return np.array(q)
    return pose_at(float(scipy.optimize.brentq(lambda x: function(pose_at(x)), a, b, xtol=1e-14)))


def _singular_pose(mechanism: Mechanism, near: np.ndarray, coordinate: int) -> np.ndarray:
    """Return the pose with phi = 0 and det J_z = 0 next to `near`; `near` itself where that does not converge."""
    index = int(mechanism.independent[coordinate])
    free = [*[int(i) for i in mechanism.dependent], index]
    at_home, here = (np.array(mechanism.dynamics.block_singularity(q)).ravel() for q in (mechanism.home, near))
    at_home = np.where(at_home == 0, 1.0, at_home)
    block = int(np.argmin(np.abs(here / at_home)))  # the loops that fold

    def fold(q: np.ndarray) -> float:
        if mechanism.projected:
            return float(mechanism.dynamics.orientation(near, q)[block]) / here[block] / at_home[block]
        return float(mechanism.dynamics.block_singularity(q)[block]) / at_home[block]

    def system(x: np.ndarray) -> np.ndarray:
        q = np.array(near)
        q[free] = x
        phi = np.array(closure(q)).ravel()
        return np.append(phi, fold(q))

    # Normal equations are blind to the gap that opens where J_z loses rank: all rows are looked at there.
    closure = mechanism.dynamics.closure if mechanism.projected else mechanism.dynamics.independent_closure
    method = "lm" if mechanism.projected else "hybr"
    solution = scipy.optimize.root(system, near[free], tol=1e-14, method=method)
    pose = np.array(near)
    pose[free] = solution.x
    close = np.max(np.abs(pose - near) / _step_sizes(mechanism)) < 4
    return pose if close and np.abs(system(solution.x)).max() < max(1e-8, mechanism.closed_m) else np.array(near)


def _toggles(mechanism: Mechanism, coordinate: int, poses: np.ndarray) -> tuple[tuple[int, float], ...]:
    """Return where each dependent joint's rate against the independent one changes sign."""
    index = mechanism.independent[coordinate]

    def rate(pose: np.ndarray, joint: int) -> float:
        return float(np.array(mechanism.dynamics.velocity_map(pose))[joint, coordinate])

    found = []
    rates = np.array([np.array(mechanism.dynamics.velocity_map(pose))[:, coordinate] for pose in poses])
    rates[np.abs(rates) < _STILL] = 0.0
    for joint in mechanism.dependent:
        moving = np.flatnonzero(rates[:, joint])  # a sample on the toggle itself has no sign: its neighbours have
        for before, after in pairwise(moving):
            if rates[before, joint] * rates[after, joint] > 0:
                continue
            if after > before + 1:
                found.append((int(joint), float(poses[(before + after) // 2, index])))
                continue
            pose = _pose_where(mechanism, poses[before], poses[after], coordinate, lambda p, j=int(joint): rate(p, j))
            found.append((int(joint), float(pose[index])))
    return tuple(sorted(found, key=lambda item: item[1]))
