"""Poses of a mechanism on its branch, along a path of independent positions.

A path is followed by a tangent predictor and Newton in the dependent joints. Where Newton fails, corrects by more than
the step itself, or the sign of a block of det J_z turns, the step is halved: so a pose found is on the branch that the path
began on, and a path that meets a singular pose stops there instead of slipping through.
"""

import functools

import numpy as np

from linkplan.models.closure.newton import CLOSED_M
from linkplan.models.deadline import NO_DEADLINE, Deadline
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import evaluated, sampled
from linkplan.models.poses.continuation import MOST_CORRECTED, MOST_TURNED, stride_along
from linkplan.models.tree.joints import where

_STEP = 0.035  # two degrees [rad]; on a slide, this share of the model's extent
_MIN_SHARE = 1e-5  # of a step: shorter than this, the path has met a singular pose
_NEWTON_STEPS = 12
# A pose further away than this many steps (some 500 turns) is taken for a typing error.
_MOST_STEPS = 1e5


def follow(
    mechanism: Mechanism, path: np.ndarray, start: np.ndarray | None = None, deadline: Deadline = NO_DEADLINE
) -> np.ndarray:
    """Return the poses (n, n_q) on the branch of `start` along positions s of the independent joints (n, n_s).

    Args:
        mechanism: whose loops are to stay closed.
        path: independent positions [rad or m], each near the one before; the first may be far from `start`.
        start: a closed pose (n_q,); home by default.
        deadline: until when the path may be followed.

    Raises:
        AssemblyError: naming the joint's position at which the loop opens, or the ball joint whose chart the motion leaves.
        OutOfTimeError: when the deadline passes before its end.
    """
    q = np.array(mechanism.home if start is None else start, dtype=float)
    path = np.asarray(path, dtype=float)
    poses, arrived = led(mechanism, q, path, deadline)
    if arrived < len(path):
        raise AssemblyError(
            f"mechanism '{mechanism.name}' does not close at {_where(mechanism, path[arrived])}: the kinematic loop opens at"
            f" {_where(mechanism, poses[-1][mechanism.independent])}"
        )
    left = mechanism.coordinates.range_violation(poses)
    if left is not None:
        raise AssemblyError(f"mechanism '{mechanism.name}' turns {left}")
    return poses


def led(mechanism: Mechanism, q: np.ndarray, path: np.ndarray, deadline: Deadline = NO_DEADLINE) -> tuple[np.ndarray, int]:
    """Return the poses at the positions of a path, led from pose q, and how many there are.

    Where the path cannot be followed to its end, one pose more: the last on the branch before the loop comes apart.
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
        if k < len(path):  # from the last regular pose on, with steps as short as it takes
            q, arrived = advance(mechanism, q, path[k], deadline)
            if not arrived:
                return np.concatenate([poses[:k], q[None]]), k
            poses[k] = q
            k += 1
    return poses, len(path)


def _strides(mechanism: Mechanism, path: np.ndarray, step_size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions at most a step apart from the first of a path (n + 1, n_s) to its last, and the number to each."""
    ways = np.diff(path, axis=0)
    long = np.max(np.abs(ways) / step_size, axis=1, initial=0.0)
    if not long.sum() < _MOST_STEPS:
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


def _stays_on_branch(mechanism: Mechanism, poses: np.ndarray) -> bool:
    """Return True if all rows of overconstrained loops are closed at poses (n, n_q), and no block folds between two."""
    return not np.any(mechanism.gaps_m(poses[:1]) > mechanism.closed_m) and _on_branch(mechanism, poses) == len(poses) - 1


def _on_branch(mechanism: Mechanism, poses: np.ndarray) -> int:
    """Return how many poses after the first (n, n_q) close all rows of overconstrained loops without a fold on the way."""
    if len(poses) < 2:
        return 0
    closed = mechanism.gaps_m(poses[1:]) <= mechanism.closed_m
    turned = sampled(mechanism.dynamics.orientation, poses[:-1], poses[1:])
    stays = closed & np.all(turned.reshape(len(closed), -1) > 0, axis=1)
    return len(stays) if np.all(stays) else int(np.argmin(stays))


def close_at(mechanism: Mechanism, s: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
    """Return the pose (n_q,) at independent positions s (n_s,), reached from `start` (home by default) on its branch."""
    if start is None:
        return _from_home(mechanism, tuple(np.asarray(s, dtype=float).ravel().tolist())).copy()
    return follow(mechanism, np.atleast_2d(np.asarray(s, dtype=float)), start)[0]


@functools.lru_cache(maxsize=16)
def _from_home(mechanism: Mechanism, s: tuple[float, ...]) -> np.ndarray:
    """Return the pose at s on the branch of home: start and goal are asked for five times in every plan."""
    return follow(mechanism, np.array([s]))[0]


def _where(mechanism: Mechanism, s: np.ndarray) -> str:
    return where(mechanism.joints, dict(zip(mechanism.independent.tolist(), s.tolist(), strict=True)))


def step_sizes(mechanism: Mechanism) -> np.ndarray:
    """Return how far (n_q,) [rad or m] each joint goes in a step."""
    extent = mechanism.extent_m
    return np.array([_STEP if joint.kind == "hinge" else _STEP * extent for joint in mechanism.joints])


def advance(
    mechanism: Mechanism, q: np.ndarray, target: np.ndarray, deadline: Deadline = NO_DEADLINE
) -> tuple[np.ndarray, bool]:
    """Return the pose at `target`, or the last one on the branch before the loop comes apart, and whether it arrived."""
    independent, dependent = mechanism.independent, mechanism.dependent
    step_size = step_sizes(mechanism)
    q = np.array(q, dtype=float)
    _, _, gamma, determinants = evaluated(mechanism.dynamics.closure_step, q)
    share = 1.0
    longest = np.max(np.abs(target - q[independent]) / step_size[independent], initial=0.0)
    if not longest < _MOST_STEPS:
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
        turned = np.max(np.abs(gamma_trial - gamma), initial=0.0) > MOST_TURNED * (1 + np.max(np.abs(gamma), initial=0.0))
        regular = np.isfinite(moved) and moved < MOST_CORRECTED and not turned and np.all(dets_trial * determinants > 0)
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
        phi, step, gamma, determinants = evaluated(mechanism.dynamics.closure_step, q)
        step = step.ravel()
        size = np.abs(step).max(initial=0.0)
        if not np.isfinite(size) or size > 10:
            break
        # One step past convergence costs little and leaves rounding only.
        done = np.abs(phi).max(initial=0.0) <= CLOSED_M and (size < 1e-12 or iteration > 2)
        q[dependent] += step
        if done or step.size == 0:
            return q, gamma, determinants
    return np.full_like(q, np.nan), np.full((mechanism.n_q, mechanism.dof), np.nan), np.array(np.nan)
