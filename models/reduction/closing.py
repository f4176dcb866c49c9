"""Closing the loops at other independent positions: a stride as CasADi expressions, and continuation by strides in numbers.

A stride predicts the pose along the tangent, q + Gamma ds, and takes a fixed number of Newton steps in the dependent
coordinates z. It is regular if the loops close, Newton's correction is small, Gamma changes little, and no determinant of a
block of J_z changes sign. Its pose is then on the branch of its start. Continuation halves strides that are not regular, and
ends at a singular pose.
"""

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.models.closure.newton import CLOSED_M
from linkplan.models.compiled.functions import evaluated, mapped
from linkplan.models.deadline import NO_DEADLINE, Deadline
from linkplan.models.reduction.reduced import ReducedDynamics

# Longest step of a joint [rad; extents on a slide], about two degrees.
STEP_RAD = 0.035
# Most steps of a path (about 500 turns). A pose further away is a typing error.
MAX_PATH_STEPS = 1e5
# Shortest step as a share of the longest. Below it the path has met a singular pose.
_LEAST_STEP_SHARE = 1e-5
# Newton steps of a stride of two degrees: two steps leave 1e-12, the third leaves rounding.
_NEWTON_STEPS = 3
# Newton's correction in a regular stride, as a share of the longest step: largest value.
_MAX_CORRECTION_SHARE = 0.25
# The last Newton step in a regular stride, as a share of the stride, and what is added for rounding [longest steps].
_MAX_LAST_SHARE, _LAST_ROUNDING = 1e-3, 1e-8
# The change of Gamma in a regular stride, as a share of its size plus one.
_MAX_GAMMA_CHANGE = 0.5
# Largest gap of loops that count as closed in a feedback loop [m]. A larger one means that the position is too far from the
# near pose.
MAX_LOOP_GAP_M = 1e-6
# Strides from a near pose to a measured position, each with this many Newton steps.
_NEAR_STRIDES, _NEAR_NEWTON_STEPS = 4, 2


@functools.lru_cache(maxsize=64)
def closing_step(dynamics: ReducedDynamics) -> ca.Function:
    """Return the function q -> Newton's step in z: `closure_step` without Gamma, its most expensive part."""
    q = ca.SX.sym("q", dynamics.closure.size1_in(0))
    return ca.Function("newton_step", [q], dynamics.closure_step.call([q])[:1])


def corrected(dynamics: ReducedDynamics, q: ca.MX, newton_steps: int) -> ca.MX:
    """Return the pose q (n_q,) after Newton steps in its dependent coordinates."""
    dependent, q = list(dynamics.dependent), ca.MX(q)
    for _ in range(newton_steps if dependent else 0):
        q[dependent] += closing_step(dynamics)(q)
    return q


def gap_at(dynamics: ReducedDynamics, q: ca.MX) -> ca.MX:
    """Return the loops' largest gap [m] at a pose q (n_q,)."""
    return ca.norm_inf(dynamics.independent_closure(q)) if dynamics.dependent else ca.MX(0)


def predicted(dynamics: ReducedDynamics, q: ca.MX, gamma: ca.MX, target: ca.MX) -> ca.MX:
    """Return the pose (n_q,) at independent positions `target` (n_s,) along the tangent of a pose q."""
    independent = list(dynamics.independent)
    q = q + gamma @ (target - q[independent])
    q[independent] = target
    return q


def closed_near(dynamics: ReducedDynamics, near: ca.MX, s: ca.MX) -> tuple[ca.MX, ca.MX]:
    """Return the pose q (n_q,) at independent positions s (n_s,) on the assembly branch of a near pose, and the gap [m]."""
    independent, q = list(dynamics.independent), ca.MX(near)
    if not dynamics.dependent:
        q[independent] = s
        return q, ca.MX(0)
    for left in range(_NEAR_STRIDES, 0, -1):
        target = q[independent] + (s - q[independent]) / left
        q = corrected(dynamics, predicted(dynamics, q, dynamics.velocity_map(q), target), _NEAR_NEWTON_STEPS)
    return q, gap_at(dynamics, q)


def calls_near(dynamics: ReducedDynamics) -> list[tuple[ca.Function, int]]:
    """Return the functions that `closed_near` calls, and how often."""
    if not dynamics.dependent:
        return []
    calls = [(dynamics.velocity_map, _NEAR_STRIDES), (closing_step(dynamics), _NEAR_STRIDES * _NEAR_NEWTON_STEPS)]
    return [*calls, (dynamics.independent_closure, 1)]


@functools.lru_cache(maxsize=64)
def moved_entries(dynamics: ReducedDynamics) -> np.ndarray:
    """Return the indices of the entries of Gamma, by columns, that are not zero at every pose."""
    q = ca.SX.sym("q", dynamics.closure.size1_in(0))
    rows, columns = ca.sparsify(dynamics.velocity_map(q)).sparsity().get_triplet()
    return np.array(columns, dtype=int) * q.numel() + np.array(rows, dtype=int)


@functools.lru_cache(maxsize=64)
def stretch(dynamics: ReducedDynamics, length: int = 1) -> ca.Function:
    """Return the function of `length` strides: (state, positions) -> states, the closure's residuals phi, corrections of z.

    A state contains a pose, the `moved_entries` of its Gamma and the determinants of J_z's blocks. These are evaluated
    before the last Newton step, which shares their factorisation. The corrections (2 n_z,) are Newton's whole correction,
    and its last step.
    """
    if length > 1:
        return stretch(dynamics).mapaccum(length)
    n_q, n_s = dynamics.velocity_map.size_out(0)
    entries = moved_entries(dynamics)
    pattern = ca.Sparsity.triplet(n_q, n_s, (entries % n_q).tolist(), (entries // n_q).tolist())
    state = ca.MX.sym("state", n_q + len(entries) + dynamics.closure_step.size1_out(2))
    target = ca.MX.sym("target", n_s)
    before = predicted(dynamics, state[:n_q], ca.MX(pattern, state[n_q : n_q + len(entries)]), target)
    q, dependent = corrected(dynamics, before, _NEWTON_STEPS - 1), list(dynamics.dependent)
    step, gamma, determinants = dynamics.closure_step(q)
    q[dependent] += step
    after, corrections = (
        ca.vertcat(q, ca.vec(gamma)[entries.tolist()], determinants),
        ca.vertcat((q - before)[dependent], step),
    )
    return ca.Function("stride", [state, target], [after, dynamics.independent_closure(q), corrections])


@functools.lru_cache(maxsize=64)
def _state(dynamics: ReducedDynamics) -> ca.Function:
    """Return the function q -> state of `stretch`."""
    q = ca.MX.sym("q", dynamics.closure.size1_in(0))
    _, gamma, determinants = dynamics.closure_step(q)
    return ca.Function("state", [q], [ca.vertcat(q, ca.vec(gamma)[moved_entries(dynamics).tolist()], determinants)])


def states_at(dynamics: ReducedDynamics, q: np.ndarray) -> np.ndarray:
    """Return the states of `stretch` at poses q (n, n_q)."""
    return evaluated(mapped(_state(dynamics), len(q)), q.T)[0].T


def rates_at(dynamics: ReducedDynamics, q: np.ndarray, coordinate: int) -> np.ndarray:
    """Return the rates (n, n_q) of all joints by that of one independent coordinate at poses q (n, n_q)."""
    rates, n_q, entries = np.zeros(q.shape), q.shape[1], moved_entries(dynamics)
    of = entries // n_q == coordinate
    rates[:, entries[of] % n_q] = states_at(dynamics, q)[:, n_q : n_q + len(entries)][:, of]
    return rates


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Closing:
    """The rules of strides: the longest of each joint, `step_size` (n_q,) [rad or m], and a further condition of regularity.

    `stay` maps poses before and after strides (m, n_q) to a mask (m,).
    """

    dynamics: ReducedDynamics
    step_size: np.ndarray
    stay: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None


def are_regular(
    closing: Closing, before: np.ndarray, after: np.ndarray, phi: np.ndarray, corrections: np.ndarray
) -> np.ndarray:
    """Return a mask (n,) of the regular strides between states (n, ...)."""
    dependent, n_q, n = list(closing.dynamics.dependent), len(closing.step_size), len(moved_entries(closing.dynamics))
    (gamma, dets), (gamma_after, dets_after) = (np.split(x[:, n_q:], [n], axis=1) for x in (before, after))
    sizes = np.max(np.abs(after - before)[:, :n_q] / closing.step_size, axis=1, initial=0.0)
    moved, last = (np.max(np.abs(x) / closing.step_size[dependent], axis=1, initial=0.0) for x in np.hsplit(corrections, 2))
    regular = (np.abs(phi).max(axis=1, initial=0.0) <= CLOSED_M) & (moved < _MAX_CORRECTION_SHARE)
    regular &= last <= _MAX_LAST_SHARE * sizes + _LAST_ROUNDING
    turned, sizes = (np.abs(x).max(axis=1, initial=0.0) for x in (gamma_after - gamma, gamma))
    regular &= (turned <= _MAX_GAMMA_CHANGE * (1 + sizes)) & np.all(dets_after * dets > 0, axis=1)  # NaN: irregular
    if closing.stay is not None and np.any(regular):
        regular[regular] = closing.stay(before[regular, :n_q], after[regular, :n_q])
    return regular


def moved_to(dynamics: ReducedDynamics, starts: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Return poses (n, n_q) with other independent positions (n, n_s), the dependent ones unchanged."""
    found = np.array(starts, dtype=float)
    found[:, list(dynamics.independent)] = positions
    return found


def one_stride(closing: Closing, states: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the states (n, ...) after a stride from each of the states, and a mask (n,) of the regular strides."""
    function = mapped(stretch(closing.dynamics), len(states))
    with np.errstate(over="ignore", invalid="ignore"):
        after, phi, corrections = (x.T for x in evaluated(function, states.T, positions.T))
        return after, are_regular(closing, states, after, phi, corrections)


def continued(
    closing: Closing, starts: np.ndarray, targets: np.ndarray, deadline: Deadline = NO_DEADLINE
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Continue closed poses (n, n_q) to positions (n, n_s) side by side; yield rows after regular strides, and their poses.

    A row's last pose is at its target, or the last one before its loops open.
    """
    dynamics, active = closing.dynamics, np.arange(len(starts))
    independent, n_q = list(dynamics.independent), starts.shape[1]
    if not (dynamics.dependent and len(starts)):
        yield active, moved_to(dynamics, starts, targets)
        return
    states, share = states_at(dynamics, starts), np.ones(len(starts))
    while True:
        deadline.require_time()
        left = targets[active] - states[active][:, independent]
        longest = np.max(np.abs(left) / closing.step_size[independent], axis=1, initial=0.0)
        going = (longest != 0.0) & (longest < MAX_PATH_STEPS) & (share[active] >= _LEAST_STEP_SHARE)
        active, left, longest = active[going], left[going], longest[going]
        if not len(active):
            return
        fraction = np.minimum(1.0, share[active] / longest)[:, None]
        position = np.where(fraction == 1.0, targets[active], states[active][:, independent] + fraction * left)
        # Few sizes of maps: CasADi takes longer to set one up than to evaluate it.
        n_rows = 1 if len(active) == 1 else max(16, 1 << (len(active) - 1).bit_length())
        rows = np.minimum(np.arange(n_rows), len(active) - 1)
        after, regular = (x[: len(active)] for x in one_stride(closing, states[active[rows]], position[rows]))
        states[active[regular]] = after[regular]
        share[active] = np.where(regular, np.minimum(1.0, 2 * share[active]), 0.5 * np.minimum(share[active], longest))
        if np.any(regular):
            yield active[regular], after[regular, :n_q]
