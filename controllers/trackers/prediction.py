"""The quadratic program of a predicted motion: the reduced dynamics under held corrections, linearised along the motion."""

import functools
import hashlib
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

from linkplan.models.compiled.functions import compiled_as_asked, tools_hash
from linkplan.models.mechanism import Mechanism
from linkplan.models.reduction.closing import closed_near

# To compute the exponential over a block, the block is halved this many times, and the result squared as often: near a
# singular pose the derivatives are up to 2^5 per block.
_EXPONENTIAL_DOUBLINGS = 5


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Predictor:
    """Programs over blocks of held corrections, with one fourth-order Runge-Kutta step per block.

    `step`: (q, v), what acts (`acting`) -> (q, v) after a block. `program`: near pose q, s, v, the references of the blocks
    ((q, v) at their beginnings, the mean of what acts, and `step` of both), corrections (n_u, blocks), Q, R, P -> Hessian,
    gradient in the changes of the corrections, loop gap of the first pose [m]. The error after a block is measured from
    `step` of the reference, so that integration errors cancel and a state on the reference needs no correction.
    """

    step: ca.Function
    program: ca.Function


def predictor(mechanism: Mechanism, kept: np.ndarray, blocks: int, block_s: float, compile_mode: str = "auto") -> Predictor:
    """Return the predictor of a mechanism's errors over blocks of a length [s], in the states `kept` (m,) of (s, v).

    `compile_mode` is "auto", "always" or "never" (`models.compiled`); compiled functions give the same numbers.
    """
    found = _interpreted(mechanism, kept, blocks, block_s)
    if compile_mode == "never":
        return found
    digest = hashlib.sha256(tools_hash(Path(__file__).parent) + found.program.serialize().encode())
    return compiled_as_asked(f"k{digest.hexdigest()[:32]}", Predictor, lambda: found, compile_mode)


def _interpreted(mechanism: Mechanism, kept: np.ndarray, blocks: int, block_s: float) -> Predictor:
    n_q, n_s, n_u, m = mechanism.n_q, mechanism.dof, mechanism.n_u, len(kept)
    state, mean = ca.MX.sym("state", n_q + n_s), acting(mechanism)
    step = ca.Function("step", [state, mean], [runge_kutta(mechanism, state, mean, block_s)])
    error, begin, own = (ca.MX.sym(name, n_q + n_s) for name in ("error", "begin", "own"))
    correction = ca.MX.sym("correction", n_u)
    corrected = mean + (correction if mean.numel() == n_u else ca.vertcat(correction, ca.DM.zeros(mean.numel() - n_u)))
    before, after = begin + error, step(begin + error, corrected)
    slopes = _slopes(mechanism, 0.5 * (before + after), corrected, kept, block_s)
    block = ca.Function("block", [error, begin, mean, own, correction], [after - own, *slopes])

    near, s, v = ca.MX.sym("near", n_q), ca.MX.sym("s", n_s), ca.MX.sym("v", n_s)
    begins, owns = ca.MX.sym("begins", n_q + n_s, blocks), ca.MX.sym("owns", n_q + n_s, blocks)
    means, corrections = ca.MX.sym("means", mean.numel(), blocks), ca.MX.sym("corrections", n_u, blocks)
    Q, R, P = ca.MX.sym("Q", m, m), ca.MX.sym("R", n_u, n_u), ca.MX.sym("P", m, m)
    q, gap = closed_near(mechanism.dynamics, near, s)
    first = ca.vertcat(q, v) - begins[:, 0]
    errors, A, B = block.mapaccum(blocks)(first, begins, means, owns, corrections)
    chosen = [*mechanism.independent.tolist(), *range(n_q, n_q + n_s)]
    reduced = errors[[chosen[i] for i in kept.tolist()], :]
    hessian, gradient = condensing(blocks, m, n_u)(A, B, reduced, corrections, Q, R, P)
    given = [near, s, v, begins, means, owns, corrections, Q, R, P]
    return Predictor(step=step, program=ca.Function("program", given, [hessian, gradient, gap]))


def _slopes(mechanism: Mechanism, state: ca.MX, held: ca.MX, kept: np.ndarray, block_s: float) -> tuple[ca.MX, ca.MX]:
    """Return A (m, m) and B (m, n_u) of the states `kept` of (s, v) over a block [s], linearised about one state.

    The exponential of (A, B) comes from a series of fourth order by scaling and squaring.
    """
    n_q, n_s, n_u = mechanism.n_q, mechanism.dof, mechanism.n_u
    by_s, by_v, by_u = mechanism.forced.linearisation(state[:n_q], state[n_q:], *_inputs(mechanism, held))
    still = ca.DM(n_u, 2 * n_s + n_u)
    slope = ca.vertcat(ca.horzcat(ca.DM(n_s, n_s), ca.DM.eye(n_s), ca.DM(n_s, n_u)), ca.horzcat(by_s, by_v, by_u), still)
    part = slope * (block_s / 2**_EXPONENTIAL_DOUBLINGS)
    whole = ca.DM.eye(2 * n_s + n_u)
    power = whole
    for order in (1, 2, 3, 4):
        power = part @ power / order
        whole = whole + power
    for _ in range(_EXPONENTIAL_DOUBLINGS):
        whole = whole @ whole
    rows = kept.tolist()
    return ca.densify(whole[rows, rows]), ca.densify(whole[rows, 2 * n_s :])


@functools.cache
def condensing(blocks: int, m: int, n_u: int) -> ca.Function:
    """Return the function (A, B, e, w, Q, R, P) -> Hessian, gradient in changes d (N n_u,) of the corrections.

    dx_{b+1} = A_b dx_b + B_b d_b. The cost penalises e + dx (m, N), with P for the last block, and w + d (n_u, N).
    Multipliers are summed backwards along the motion (Andersson, PhD thesis, KU Leuven, 2013, section 5.3).
    """
    A, B, e = ca.SX.sym("A", m, m * blocks), ca.SX.sym("B", m, n_u * blocks), ca.SX.sym("e", m, blocks)
    w, Q, R, P = ca.SX.sym("w", n_u, blocks), ca.SX.sym("Q", m, m), ca.SX.sym("R", n_u, n_u), ca.SX.sym("P", m, m)
    A_of, B_of = ca.horzsplit(A, m), ca.horzsplit(B, n_u)
    weight = [Q] * (blocks - 1) + [P]

    def summed(states: list[ca.SX], first: int) -> list[ca.SX]:
        """Return B_b^T l_b of blocks from `first`, with l_b = Q x_b + A_{b+1}^T l_{b+1}."""
        found, multiplier = [], ca.SX(m, 1)
        for b in range(blocks - 1, first - 1, -1):
            multiplier = weight[b] @ states[b - first] + (A_of[b + 1].T @ multiplier if b + 1 < blocks else 0)
            found.append(B_of[b].T @ multiplier)
        return found[::-1]

    hessian = ca.SX(blocks * n_u, blocks * n_u)
    for b in range(blocks):
        states = [B_of[b]]
        for later in range(b + 1, blocks):
            states.append(A_of[later] @ states[-1])
        columns = slice(b * n_u, (b + 1) * n_u)
        for later, part in enumerate(summed(states, b), b):
            rows = slice(later * n_u, (later + 1) * n_u)
            hessian[rows, columns] = part + (R if later == b else 0)
            hessian[columns, rows] = hessian[rows, columns].T
    gradient = ca.vertcat(*(part + R @ w[:, b] for b, part in enumerate(summed(ca.horzsplit(e, 1), 0))))
    return ca.Function("condensing", [A, B, e, w, Q, R, P], [hessian, gradient])


def acting(mechanism: Mechanism) -> ca.MX:
    """Return a symbol for what acts over a time: the efforts (n_u,), and after them the forces over time."""
    return ca.MX.sym("acting", mechanism.n_u + (0 if mechanism.forces is None else 3 * len(mechanism.forces.sites)))


def _inputs(mechanism: Mechanism, held: ca.MX) -> list[ca.MX]:
    """Return the efforts and the forces of `acting` as the last inputs of the `forced` dynamics."""
    return [held] if mechanism.forces is None else ca.vertsplit(held, [0, mechanism.n_u, held.numel()])


def runge_kutta(mechanism: Mechanism, state: ca.MX, held: ca.MX, duration: ca.MX | float) -> ca.MX:
    """Return (q, v) after a duration [s] under held efforts and forces (`acting`): one Runge-Kutta step of fourth order."""
    n_q, inputs = mechanism.n_q, _inputs(mechanism, held)

    def slope(x: ca.MX) -> ca.MX:
        return ca.vertcat(*mechanism.forced.flow(x[:n_q], x[n_q:], *inputs))

    k1 = slope(state)
    k2 = slope(state + 0.5 * duration * k1)
    k3 = slope(state + 0.5 * duration * k2)
    k4 = slope(state + duration * k3)
    return state + duration / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
