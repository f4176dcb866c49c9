"""Poses of a mechanism on its branch, along a path of independent positions.

A path is followed by a tangent predictor and Newton in the dependent joints. The step is halved if Newton fails, if its
correction is too large, or if the determinant of a block of J_z changes sign. A pose is therefore on the branch of the
path's start, and a path stops at a singular pose.

Many positions are followed in one call of a CasADi function: a stride from pose to pose has a fixed number of Newton steps,
and CasADi's mapaccum repeats it. The result is checked afterwards by the rules of `advance`, which takes over at the first
stride that is not regular.
"""

import functools
from collections.abc import Iterator

import casadi as ca
import numpy as np

from linkplan.models.closure.newton import CLOSED_M
from linkplan.models.deadline import NO_DEADLINE, Deadline
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import evaluated, mapped, sampled
from linkplan.models.poses.period import travel_scales
from linkplan.models.tree.joints import unit_steps, where

# Newton steps of a stride of two degrees: two steps leave 1e-12, the third leaves rounding.
_NEWTON_STEPS = 3
# Numbers of strides in one call.
_STRETCH_LENGTHS = (1, 4, 16, 64, 128, 256)
# A stride is regular if Newton's correction is below this share of the step,
MAX_CORRECTION_SHARE = 0.25
# and if Gamma changes by less than this share of its size.
MAX_GAMMA_CHANGE = 0.5


def stride_along(
    mechanism: Mechanism,
    q: np.ndarray,
    positions: np.ndarray,
    step_size: np.ndarray,
    deadline: Deadline = NO_DEADLINE,
) -> np.ndarray:
    """Return the poses (m, n_q) at positions (n, n_s), followed from pose q on until a stride is irregular: the first m.

    Positions are at most a step (`step_size`, (n_q,) [rad or m]) apart.
    """
    moved = np.any(positions != q[mechanism.independent], axis=0)
    if not np.any(moved & in_loops(mechanism)):
        return _moved(mechanism, np.tile(q, (len(positions), 1)), positions)
    state = _states(mechanism, q[None])[0]
    # CasADi takes longer to set up a function of more values than to make several calls.
    most = max(length for length in _STRETCH_LENGTHS if length == 1 or length * len(state) <= 40_000)
    found: list[np.ndarray] = [np.empty((0, mechanism.n_q))]
    begin, longest = 0, min(16, most)  # the first call is short, because few strides are regular near a singular pose
    while begin < len(positions):
        deadline.require_time()
        n = min(longest, len(positions) - begin)
        length = next(length for length in _STRETCH_LENGTHS if length >= n)
        targets = positions[np.minimum(np.arange(begin, begin + length), len(positions) - 1)]
        states, phi, predicted = (x.T[:n] for x in evaluated(_stretch(mechanism, length), state, targets.T))
        kept = _are_regular(mechanism, np.concatenate([state[None], states[:-1]]), states, phi, predicted, step_size)
        regular = n if np.all(kept) else int(np.argmin(kept))
        found.append(states[:regular, : mechanism.n_q])
        if regular < n:
            break
        state, begin, longest = states[-1], begin + n, most
    return np.concatenate(found)


def strides(mechanism: Mechanism, starts: np.ndarray, positions: np.ndarray, step_size: np.ndarray) -> np.ndarray:
    """Return the poses (n, n_q) at positions (n, n_s), each one stride from its own start (n, n_q); NaN if irregular."""
    if len(mechanism.dependent) == 0 or len(starts) == 0:
        return _moved(mechanism, starts, positions)
    states, function = _states(mechanism, starts), mapped(_stretch(mechanism, 1), len(starts))
    with np.errstate(over="ignore", invalid="ignore"):
        after, phi, predicted = (x.T for x in evaluated(function, states.T, positions.T))
        regular = _are_regular(mechanism, states, after, phi, predicted, step_size)
    return np.where(regular[:, None], after[:, : mechanism.n_q], np.nan)


def _moved(mechanism: Mechanism, starts: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Return poses (n, n_q) with other independent positions (n, n_s), the dependent ones as they were."""
    found = np.array(starts, dtype=float)
    found[:, mechanism.independent] = positions
    return found


def _states(mechanism: Mechanism, q: np.ndarray) -> np.ndarray:
    """Return the states of `_stretch` at poses q (n, n_q)."""
    gamma, determinants = evaluated(mapped(mechanism.dynamics.closure_step, len(q)), q.T)[2:]
    return np.hstack([q, gamma.ravel(order="F").reshape(len(q), -1), determinants.T])


@functools.lru_cache(maxsize=16)
def in_loops(mechanism: Mechanism) -> np.ndarray:
    """Return a mask (n_s,) of the independent coordinates that the closure depends on."""
    depends = np.array(ca.DM(mechanism.dynamics.independent_closure.jac_sparsity(0, 0), 1.0)) != 0
    return depends[:, mechanism.independent].any(axis=0)


def _are_regular(
    mechanism: Mechanism,
    before: np.ndarray,
    after: np.ndarray,
    phi: np.ndarray,
    predicted: np.ndarray,
    step_size: np.ndarray,
) -> np.ndarray:
    """Return a mask (n,) of the regular strides between states (n, ...)."""
    dependent, n_q = mechanism.dependent, mechanism.n_q
    n_gamma = n_q * mechanism.dof
    (gamma, dets), (gamma_after, dets_after) = (np.split(states[:, n_q:], [n_gamma], axis=1) for states in (before, after))
    corrected = np.max(np.abs(after[:, dependent] - predicted) / step_size[dependent], axis=1, initial=0.0)
    turned, sizes = (np.abs(x).max(axis=1, initial=0.0) for x in (gamma_after - gamma, gamma))
    regular = (np.abs(phi).max(axis=1, initial=0.0) <= CLOSED_M) & (corrected < MAX_CORRECTION_SHARE)
    return regular & (turned <= MAX_GAMMA_CHANGE * (1 + sizes)) & np.all(dets_after * dets > 0, axis=1)  # NaN: irregular


@functools.lru_cache(maxsize=16)
def _stretch(mechanism: Mechanism, length: int) -> ca.Function:
    """Return the function of `length` strides: (state, positions) -> states, the closure's residuals phi, predicted z.

    A state contains a pose, its Gamma by columns and the determinants of J_z's blocks.
    """
    independent, dependent = (index.tolist() for index in (mechanism.independent, mechanism.dependent))
    closure_step, n_q, dof = mechanism.dynamics.closure_step, mechanism.n_q, mechanism.dof
    place = ca.SX.sym("q", n_q)
    newton = ca.Function("newton", [place], closure_step.call([place])[:2])  # Gamma, the most expensive part, is left out
    state = ca.MX.sym("state", n_q + n_q * dof + closure_step.size1_out(3))
    target = ca.MX.sym("target", dof)
    q, gamma = state[:n_q], ca.reshape(state[n_q : n_q + n_q * dof], n_q, dof)
    trial = q + gamma @ (target - q[independent])
    trial[independent] = target
    predicted = trial[dependent]
    for _ in range(_NEWTON_STEPS - 1):
        trial[dependent] += newton(trial)[1]
    _, step, gamma, determinants = closure_step(trial)
    trial[dependent] += step
    phi = mechanism.dynamics.independent_closure(trial)
    after = ca.vertcat(trial, ca.vec(gamma), determinants)
    stride = ca.Function("stride", [state, target], [after, phi, predicted])
    return stride if length == 1 else stride.mapaccum(length)


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
    stays = _stay_on_branch(mechanism, poses[:-1], poses[1:])
    return len(stays) if np.all(stays) else int(np.argmin(stays))


def _stay_on_branch(mechanism: Mechanism, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return a mask (n,) of the strides between poses (n, n_q) that close overconstrained loops without a fold."""
    closed = mechanism.gaps_m(after) <= mechanism.closed_m
    turned = sampled(mechanism.dynamics.orientation, before, after)
    return closed & np.all(turned.reshape(len(closed), -1) > 0, axis=1)


def close_at(mechanism: Mechanism, s: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
    """Return the pose (n_q,) at independent positions s (n_s,), reached from `start` (home by default) on its branch."""
    return follow(mechanism, np.atleast_2d(np.asarray(s, dtype=float)), start)[0]


def _where(mechanism: Mechanism, s: np.ndarray) -> str:
    return where(mechanism.independent_joints, s, 6)


@functools.lru_cache(maxsize=16)
def step_sizes(mechanism: Mechanism) -> np.ndarray:
    """Return the longest step (n_q,) [rad or m] of each joint; a motor behind a gear makes longer ones."""
    found = _STEP_RAD * unit_steps(mechanism.joints, mechanism.extent_m)
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
            return
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
            yield q
            continue
        share = 0.5 * min(share, longest)
        if share < _LEAST_STEP_SHARE:
            return


def advance_all(
    mechanism: Mechanism, starts: np.ndarray, targets: np.ndarray, deadline: Deadline = NO_DEADLINE
) -> np.ndarray:
    """Return the poses (n, n_q) at targets (n, n_s), each continued from its own start (n, n_q) by `advance`, side by side.

    A pose is NaN where the loop opens on the way.
    """
    step_size, independent, n_q = step_sizes(mechanism), mechanism.independent, mechanism.n_q
    if len(mechanism.dependent) == 0 or len(starts) == 0:
        return _moved(mechanism, starts, targets)
    stretch, found = _stretch(mechanism, 1), np.full(starts.shape, np.nan)
    states, share, active = _states(mechanism, starts), np.ones(len(starts)), np.arange(len(starts))
    while len(active):
        deadline.require_time()
        before = states[active]
        left = targets[active] - before[:, independent]
        longest = np.max(np.abs(left) / step_size[independent], axis=1, initial=0.0)
        whole = longest <= share[active]
        fraction = np.where(whole, 1.0, share[active] / np.maximum(longest, np.finfo(float).tiny))
        position = np.where(whole[:, None], targets[active], before[:, independent] + fraction[:, None] * left)
        # Few sizes of maps: CasADi takes longer to set one up than to evaluate it.
        rows = np.minimum(np.arange(max(16, 1 << (len(active) - 1).bit_length())), len(active) - 1)
        with np.errstate(over="ignore", invalid="ignore"):
            given = before[rows].T, position[rows].T
            after, phi, predicted = (x.T[: len(active)] for x in evaluated(mapped(stretch, len(rows)), *given))
            regular = _are_regular(mechanism, before, after, phi, predicted, step_size)
        if mechanism.projected and np.any(regular):
            regular[regular] = _stay_on_branch(mechanism, before[regular, :n_q], after[regular, :n_q])
        states[active[regular]] = after[regular]
        share[active] = np.where(regular, np.minimum(1.0, 2 * share[active]), 0.5 * np.minimum(share[active], longest))
        arrived = active[regular & whole]
        found[arrived] = states[arrived, :n_q]
        lost = ~regular & (share[active] < _LEAST_STEP_SHARE) | ~(longest < _MAX_PATH_STEPS)
        active = active[~(regular & whole) & ~lost]
    return found


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
