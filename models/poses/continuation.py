"""Poses along many positions in one call: the tangent predictor and Newton of `poses.assembly` as one CasADi function.

A file whose job is speed. A stride from pose to pose is a fixed number of Newton steps, folded over a stretch of positions
(CasADi's mapaccum). Whether a stride is regular is judged afterwards, by the rules that the walk with adaptive steps keeps;
from the first one that is not, that walk takes over.
"""

import functools

import casadi as ca
import numpy as np

from linkplan.models.closure.newton import CLOSED_M
from linkplan.models.deadline import NO_DEADLINE, Deadline
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import evaluated

# Newton steps of a stride. From a tangent's end, two degrees on, two leave 1e-12 and the third rounding.
_NEWTON_STEPS = 3
# Strides folded into one call, the last position repeated where fewer are left. The first calls are short: near a singular
# pose few strides are regular.
_STRETCHES = (1, 4, 16, 64, 128, 256)
_FIRST = 16
# A stretch of more numbers than this takes CasADi longer to lay out than several shorter ones to call.
_MOST_NUMBERS = 40_000
# A stride is regular where Newton corrects its predictor by less than this share of the step,
MOST_CORRECTED = 0.25
# and Gamma turns by less than this share of its size.
MOST_TURNED = 0.5


def stride_along(
    mechanism: Mechanism,
    q: np.ndarray,
    positions: np.ndarray,
    step_size: np.ndarray,
    deadline: Deadline = NO_DEADLINE,
) -> np.ndarray:
    """Return the poses (m, n_q) at the first m of the positions (n, n_s), led from pose q: all if all are regular.

    Positions are at most a step (`step_size`, (n_q,) [rad or m]) apart.
    """
    moved = np.any(positions != q[mechanism.independent], axis=0)
    if not np.any(moved & in_loops(mechanism)):
        poses = np.tile(q, (len(positions), 1))
        poses[:, mechanism.independent] = positions
        return poses
    gamma, determinants = evaluated(mechanism.dynamics.closure_step, q)[2:]
    state = np.concatenate([q, gamma.T.ravel(), determinants.ravel()])
    most = max(length for length in _STRETCHES if length == 1 or length * len(state) <= _MOST_NUMBERS)
    found: list[np.ndarray] = [np.empty((0, mechanism.n_q))]
    begin, longest = 0, min(_FIRST, most)
    while begin < len(positions):
        deadline.require_time()
        n = min(longest, len(positions) - begin)
        length = next(length for length in _STRETCHES if length >= n)
        targets = positions[np.minimum(np.arange(begin, begin + length), len(positions) - 1)]
        states, phi, predicted = (x.T[:n] for x in evaluated(_stretch(mechanism, length), state, targets.T))
        regular = _regular(mechanism, np.concatenate([state[None], states]), phi, predicted, step_size)
        found.append(states[:regular, : mechanism.n_q])
        if regular < n:
            break
        state, begin, longest = states[-1], begin + n, most
    return np.concatenate(found)


@functools.lru_cache(maxsize=16)
def in_loops(mechanism: Mechanism) -> np.ndarray:
    """Return which independent coordinates (n_s,) the closure depends on; the loops stand still while others move."""
    depends = np.array(ca.DM(mechanism.dynamics.independent_closure.jac_sparsity(0, 0), 1.0)) != 0
    return depends[:, mechanism.independent].any(axis=0)


def _regular(mechanism: Mechanism, states: np.ndarray, phi: np.ndarray, predicted: np.ndarray, step_size: np.ndarray) -> int:
    """Return how many of the first strides through states (n + 1, ...) are regular."""
    dependent, n_q = mechanism.dependent, mechanism.n_q
    n_gamma = n_q * mechanism.dof
    corrected = np.max(np.abs(states[1:, dependent] - predicted) / step_size[dependent], axis=1, initial=0.0)
    gamma, determinants = states[:, n_q : n_q + n_gamma], states[:, n_q + n_gamma :]
    turned = np.abs(np.diff(gamma, axis=0)).max(axis=1, initial=0.0)
    sizes = np.abs(gamma[:-1]).max(axis=1, initial=0.0)
    regular = (np.abs(phi).max(axis=1, initial=0.0) <= CLOSED_M) & (corrected < MOST_CORRECTED)
    regular &= (turned <= MOST_TURNED * (1 + sizes)) & np.all(determinants[1:] * determinants[:-1] > 0, axis=1)
    return len(regular) if np.all(regular) else int(np.argmin(regular))  # what is not a number is not regular


@functools.lru_cache(maxsize=16)
def _stretch(mechanism: Mechanism, length: int) -> ca.Function:
    """Return (state, positions) -> states, phi before the last step, predicted dependent positions, over `length` strides.

    A state is a pose, its Gamma by columns and the determinants of J_z's blocks.
    """
    independent, dependent = (index.tolist() for index in (mechanism.independent, mechanism.dependent))
    closure_step, n_q, dof = mechanism.dynamics.closure_step, mechanism.n_q, mechanism.dof
    place = ca.SX.sym("q", n_q)
    newton = ca.Function("newton", [place], closure_step.call([place])[:2])  # without Gamma, the larger part of a stride
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
