"""Poses of a mechanism on its branch, along a path of independent positions.

A path is followed by a tangent predictor and Newton in the dependent joints. The step is halved if Newton fails, if its
correction is too large, or if the determinant of a block of J_z changes sign. A pose is therefore on the branch of the
path's start, and a path stops at a singular pose.
"""

import numpy as np

from linkplan.models.closure.newton import CLOSED_M
from linkplan.models.deadline import NO_DEADLINE, Deadline
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import evaluated, sampled
from linkplan.models.poses.continuation import MAX_CORRECTION_SHARE, MAX_GAMMA_CHANGE, stride_along
from linkplan.models.tree.joints import unit_steps, where

# Longest step of a joint [rad; extents on a slide], about two degrees.
_STEP_RAD = 0.035
# Shortest step as a share of the longest. Below it the path has met a singular pose.
_LEAST_STEP_SHARE = 1e-5
# Largest distance in steps (about 500 turns). A pose further away is a typing error.
_MAX_PATH_STEPS = 1e5


def follow(
    mechanism: Mechanism, path: np.ndarray, start: np.ndarray | None = None, deadline: Deadline = NO_DEADLINE
) -> np.ndarray:
    """Return the poses (n, n_q) on the branch of `start` along positions s of the independent joints (n, n_s).

    Args:
        mechanism: the assembled mechanism.
        path: independent positions [rad or m]. Each is near the previous one; the first may be far from `start`.
        start: a closed pose (n_q,); home by default.
        deadline: of the computation.

    Raises:
        AssemblyError: if the loop opens on the way (with the position there), or if a ball joint leaves its chart.
        OutOfTimeError: if the deadline passes before the end of the path.
    """
    q = np.array(mechanism.home if start is None else start, dtype=float)
    path = np.asarray(path, dtype=float)
    poses, arrived = continue_to(mechanism, q, path, deadline)
    if arrived < len(path):
        raise AssemblyError(
            f"mechanism '{mechanism.name}' does not close at {_where(mechanism, path[arrived])}: the kinematic loop opens at"
            f" {_where(mechanism, poses[-1][mechanism.independent])}"
        )
    violation = mechanism.coordinates.range_violation(poses)
    if violation is not None:
        raise AssemblyError(f"mechanism '{mechanism.name}' turns {violation}")
    return poses


def continue_to(
    mechanism: Mechanism, q: np.ndarray, path: np.ndarray, deadline: Deadline = NO_DEADLINE
) -> tuple[np.ndarray, int]:
    """Return the poses at the positions of a path by continuation from pose q, and their number.

    If the loop opens on the way, the array has one more pose: the last one on the branch.
    """
    step_size, independent = step_sizes(mechanism), mechanism.independent
    poses, k = np.empty((len(path), mechanism.n_q)), 0
    while k < len(path):
        between, at = _strides(mechanism, np.concatenate([q[independent][None], path[k:]]), step_size[independent])
        strides = stride_along(mechanism, q, between, step_size, deadline)
        if mechanism.projected:
            strides = strides[: _on_branch(mechanism, np.concatenate([q[None], strides]))]
        reached = int(np.searchsorted(at, len(strides), side="right"))
        poses[k : k + reached] = strides[at[:reached] - 1]
        q, k = (strides[-1] if len(strides) else q), k + reached
        if k < len(path):  # continue from the last regular pose with adaptive steps
            q, arrived = advance(mechanism, q, path[k], deadline)
            if not arrived:
                return np.concatenate([poses[:k], q[None]]), k
            poses[k] = q
            k += 1
    return poses, len(path)


def _strides(mechanism: Mechanism, path: np.ndarray, step_size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions along a path (n + 1, n_s) that are at most a step apart, and their number up to each path point."""
    ways = np.diff(path, axis=0)
    long = np.max(np.abs(ways) / step_size, axis=1, initial=0.0)
    if not long.sum() < _MAX_PATH_STEPS:
        raise AssemblyError(
            f"mechanism '{mechanism.name}' does not close at {_where(mechanism, path[-1])}: further away than any motion"
            " goes"
        )
    counts = np.maximum(1, np.ceil(long)).astype(int)
    at = np.cumsum(counts)
    shares = (np.arange(at[-1]) - np.repeat(at - counts, counts) + 1) / np.repeat(counts, counts)
    between = np.repeat(path[:-1], counts, axis=0) + shares[:, None] * np.repeat(ways, counts, axis=0)
    between[at - 1] = path[1:]
    return between, at


def _on_branch(mechanism: Mechanism, poses: np.ndarray) -> int:
    """Return the number of poses (n, n_q) after the first that close overconstrained loops without a fold on the way."""
    if len(poses) < 2:
        return 0
    closed = mechanism.gaps_m(poses[1:]) <= mechanism.closed_m
    turned = sampled(mechanism.dynamics.orientation, poses[:-1], poses[1:])
    stays = closed & np.all(turned.reshape(len(closed), -1) > 0, axis=1)
    return len(stays) if np.all(stays) else int(np.argmin(stays))


def close_at(mechanism: Mechanism, s: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
    """Return the pose (n_q,) at independent positions s (n_s,), reached from `start` (home by default) on its branch."""
    return follow(mechanism, np.atleast_2d(np.asarray(s, dtype=float)), start)[0]


def _where(mechanism: Mechanism, s: np.ndarray) -> str:
    return where(mechanism.joints, dict(zip(mechanism.independent.tolist(), s.tolist(), strict=True)))


def step_sizes(mechanism: Mechanism) -> np.ndarray:
    """Return the longest step (n_q,) [rad or m] of each joint."""
    return _STEP_RAD * unit_steps(mechanism.joints, mechanism.extent_m)


def advance(
    mechanism: Mechanism, q: np.ndarray, target: np.ndarray, deadline: Deadline = NO_DEADLINE
) -> tuple[np.ndarray, bool]:
    """Return the pose at `target` and True, or the last pose on the branch before the loop opens and False."""
    independent, dependent = mechanism.independent, mechanism.dependent
    step_size = step_sizes(mechanism)
    q = np.array(q, dtype=float)
    _, _, gamma, determinants = evaluated(mechanism.dynamics.closure_step, q)
    share = 1.0
    longest = np.max(np.abs(target - q[independent]) / step_size[independent], initial=0.0)
    if not longest < _MAX_PATH_STEPS:
        raise AssemblyError(
            f"mechanism '{mechanism.name}' does not close at {_where(mechanism, target)}: further away than any motion goes"
        )
    while True:
        deadline.require_time()
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
        change = np.max(np.abs(gamma_trial - gamma), initial=0.0) / (1 + np.max(np.abs(gamma), initial=0.0))
        smooth = np.isfinite(moved) and moved < MAX_CORRECTION_SHARE and not change > MAX_GAMMA_CHANGE
        regular = smooth and np.all(dets_trial * determinants > 0)
        if regular and (not mechanism.projected or _on_branch(mechanism, np.array([q, trial]))):
            q, gamma, determinants = trial, gamma_trial, dets_trial
            share = min(1.0, 2 * share)
            continue
        share = 0.5 * min(share, longest)
        if share < _LEAST_STEP_SHARE:
            return q, False


def _correct(mechanism: Mechanism, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the pose closed by Newton in its dependent joints, Gamma and the determinants of J_z's blocks, or NaN."""
    q = np.array(q)
    dependent = mechanism.dependent
    for iteration in range(12):
        phi, step, gamma, determinants = evaluated(mechanism.dynamics.closure_step, q)
        step = step.ravel()
        size = np.abs(step).max(initial=0.0)
        if not np.isfinite(size) or size > 10:
            break
        # One step past convergence leaves only rounding.
        done = np.abs(phi).max(initial=0.0) <= CLOSED_M and (size < 1e-12 or iteration > 2)
        q[dependent] += step
        if done or step.size == 0:
            return q, gamma, determinants
    return np.full_like(q, np.nan), np.full((mechanism.n_q, mechanism.dof), np.nan), np.array(np.nan)
