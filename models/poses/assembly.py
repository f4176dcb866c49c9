"""Poses of a mechanism on its branch, along a path of independent positions.

A path is followed in strides of at most a step (`linkplan.models.reduction.closing`). A pose is therefore on the branch of
the path's start, and a path stops at a singular pose.

Many positions are followed in one call of a CasADi function, because CasADi's mapaccum repeats a stride. The result is
checked afterwards by the rules of `advance`, which takes over at the first stride that is not regular.
"""

import functools
from collections.abc import Iterator

import casadi as ca
import numpy as np

from linkplan.models.compiled.functions import evaluated
from linkplan.models.deadline import NO_DEADLINE, Deadline
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled
from linkplan.models.poses.period import travel_scales
from linkplan.models.reduction import closing
from linkplan.models.reduction.closing import MAX_PATH_STEPS, STEP_RAD, Closing
from linkplan.models.tree.joints import unit_steps, where

# Numbers of strides in one call.
_STRETCH_LENGTHS = (1, 4, 16, 64, 128, 256)


@functools.lru_cache(maxsize=16)
def closing_of(mechanism: Mechanism) -> Closing:
    """Return the rules of a mechanism's strides; overconstrained loops must also close, without a fold on the way."""

    def stay(before: np.ndarray, after: np.ndarray) -> np.ndarray:
        turned = sampled(mechanism.dynamics.orientation, before, after).reshape(len(after), -1)
        return (mechanism.gaps_m(after) <= mechanism.closed_m) & np.all(turned > 0, axis=1)

    steps = step_sizes(mechanism)
    return Closing(dynamics=mechanism.dynamics, step_size=steps, stay=stay if mechanism.projected else None)


def stride_along(mechanism: Mechanism, q: np.ndarray, positions: np.ndarray, deadline: Deadline = NO_DEADLINE) -> np.ndarray:
    """Return the poses (m, n_q) at positions (n, n_s), followed from pose q on until a stride is irregular: the first m.

    Positions are at most a step (`step_sizes`) apart.
    """
    rules, dynamics = closing_of(mechanism), mechanism.dynamics
    moved = np.any(positions != q[mechanism.independent], axis=0)
    if not np.any(moved & in_loops(mechanism)):
        return closing.moved_to(dynamics, np.tile(q, (len(positions), 1)), positions)
    state = closing.states_at(dynamics, q[None])[0]
    # CasADi takes longer to set up a function of more values than to make several calls.
    most = max(length for length in _STRETCH_LENGTHS if length == 1 or length * len(state) <= 40_000)
    found: list[np.ndarray] = [np.empty((0, mechanism.n_q))]
    begin, longest = 0, min(16, most)  # the first call is short, because few strides are regular near a singular pose
    while begin < len(positions):
        deadline.require_time()
        n = min(longest, len(positions) - begin)
        length = next(length for length in _STRETCH_LENGTHS if length >= n)
        targets = positions[np.minimum(np.arange(begin, begin + length), len(positions) - 1)]
        states, phi, corrections = (x.T[:n] for x in evaluated(closing.stretch(dynamics, length), state, targets.T))
        kept = closing.are_regular(rules, np.concatenate([state[None], states[:-1]]), states, phi, corrections)
        regular = n if np.all(kept) else int(np.argmin(kept))
        found.append(states[:regular, : mechanism.n_q])
        if regular < n:
            break
        state, begin, longest = states[-1], begin + n, most
    return np.concatenate(found)


def strides(mechanism: Mechanism, starts: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Return the poses (n, n_q) at positions (n, n_s), each one stride from its own start (n, n_q); NaN if irregular."""
    if not (mechanism.dynamics.dependent and len(starts)):
        return closing.moved_to(mechanism.dynamics, starts, positions)
    states = closing.states_at(mechanism.dynamics, starts)
    after, regular = closing.one_stride(closing_of(mechanism), states, positions)
    return np.where(regular[:, None], after[:, : mechanism.n_q], np.nan)


@functools.lru_cache(maxsize=16)
def in_loops(mechanism: Mechanism) -> np.ndarray:
    """Return a mask (n_s,) of the independent coordinates that the closure depends on."""
    depends = np.array(ca.DM(mechanism.dynamics.independent_closure.jac_sparsity(0, 0), 1.0)) != 0
    return depends[:, mechanism.independent].any(axis=0)


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
    poses, k = np.empty((len(path), mechanism.n_q)), 0
    while k < len(path):
        between, at = _strides(mechanism, np.concatenate([q[mechanism.independent][None], path[k:]]))
        strides = stride_along(mechanism, q, between, deadline)
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


def _strides(mechanism: Mechanism, path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions along a path (n + 1, n_s) that are at most a step apart, and their number up to each path point."""
    ways = np.diff(path, axis=0)
    long = np.max(np.abs(ways) / step_sizes(mechanism)[mechanism.independent], axis=1, initial=0.0)
    if not long.sum() < MAX_PATH_STEPS:
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


def close_at(mechanism: Mechanism, s: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
    """Return the pose (n_q,) at independent positions s (n_s,), reached from `start` (home by default) on its branch."""
    return follow(mechanism, np.atleast_2d(np.asarray(s, dtype=float)), start)[0]


def _where(mechanism: Mechanism, s: np.ndarray) -> str:
    return where(mechanism.independent_joints, s, 6)


@functools.lru_cache(maxsize=16)
def step_sizes(mechanism: Mechanism) -> np.ndarray:
    """Return the longest step (n_q,) [rad or m] of each joint; a motor behind a gear makes longer ones."""
    found = STEP_RAD * unit_steps(mechanism.joints, mechanism.extent_m)
    found[mechanism.independent] *= travel_scales(mechanism)
    found.setflags(write=False)
    return found


def advance(
    mechanism: Mechanism, q: np.ndarray, target: np.ndarray, deadline: Deadline = NO_DEADLINE
) -> tuple[np.ndarray, bool]:
    """Return the pose at `target` and True, or the last pose on the branch before the loop opens and False."""
    last = [np.array(q, dtype=float), *steps_to(mechanism, q, target, deadline)][-1]
    return last, bool(np.all(last[mechanism.independent] == target))


def steps_to(
    mechanism: Mechanism, q: np.ndarray, target: np.ndarray, deadline: Deadline = NO_DEADLINE
) -> Iterator[np.ndarray]:
    """Yield the poses after regular steps from pose q on, up to that at `target` or to the last before the loop opens."""
    _strides(mechanism, np.array([q[mechanism.independent], target]))
    given = np.array([q], dtype=float), np.array([target], dtype=float)
    yield from (pose for _, (pose,) in closing.continued(closing_of(mechanism), *given, deadline))


def advance_all(mechanism: Mechanism, starts: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Return the poses (n, n_q) at targets (n, n_s), each continued from its own start (n, n_q) by `advance`, side by side.

    A pose is NaN where the loop opens on the way.
    """
    found = np.array(starts, dtype=float)
    for rows, poses in closing.continued(closing_of(mechanism), starts, targets):
        found[rows] = poses
    found[np.any(found[:, mechanism.independent] != targets, axis=1)] = np.nan
    return found
