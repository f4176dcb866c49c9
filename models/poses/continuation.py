"""Poses along many positions in one call: the tangent predictor and Newton of `poses.assembly` as one CasADi function.

The purpose of this file is speed. A stride from pose to pose has a fixed number of Newton steps, and CasADi's mapaccum
repeats it over a stretch of positions. The result is checked afterwards by the rules of `poses.assembly.advance`, which
takes over at the first stride that is not regular.
"""

import functools

import casadi as ca
import numpy as np

from linkplan.models.closure.newton import CLOSED_M
from linkplan.models.deadline import NO_DEADLINE, Deadline
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import evaluated, mapped

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
    """Return the poses (m, n_q) at the first m positions (n, n_s) from pose q on, up to the first irregular stride.

    Positions are at most a step (`step_size`, (n_q,) [rad or m]) apart.
    """
    moved = np.any(positions != q[mechanism.independent], axis=0)
    if not np.any(moved & in_loops(mechanism)):
        poses = np.tile(q, (len(positions), 1))
        poses[:, mechanism.independent] = positions
        return poses
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
    states, function = _states(mechanism, starts), mapped(_stretch(mechanism, 1), len(starts))
    with np.errstate(over="ignore", invalid="ignore"):
        after, phi, predicted = (x.T for x in evaluated(function, states.T, positions.T))
        regular = _are_regular(mechanism, states, after, phi, predicted, step_size)
    return np.where(regular[:, None], after[:, : mechanism.n_q], np.nan)


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
    """Return the function of `length` strides: (state, positions) -> states, phi before the last step, predicted z.

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
    phi, step, gamma, determinants = closure_step(trial)
    trial[dependent] += step
    after = ca.vertcat(trial, ca.vec(gamma), determinants)
    stride = ca.Function("stride", [state, target], [after, phi, predicted])
    return stride if length == 1 else stride.mapaccum(length)
