"""Predicted motions: the reduced dynamics under held efforts from a given state, and their linearisation."""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.controllers.trackers.closing import MAX_LOOP_GAP_M, closed_near
from linkplan.controllers.trackers.lqr import discretise
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import evaluated, mapped

# Evaluations of the dynamics in one Runge-Kutta step.
RUNGE_KUTTA_STAGES = 4


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Predictor:
    """Motions over `blocks` blocks of `block_s` [s] each, with one fourth-order Runge-Kutta step per block."""

    mechanism: Mechanism
    blocks: int
    block_s: float
    begin: ca.Function  # q near, s -> q, gap [m]
    motion: ca.Function  # (q, v), efforts of the blocks -> (q, v) after each
    slopes: ca.Function  # q, v, efforts of the blocks -> the acceleration's derivatives by s, v, efforts

    def motions_of(
        self, near: np.ndarray, s: np.ndarray, v: np.ndarray, efforts: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return (q, v) (r, blocks + 1, n_q + n_s) from states (r, n_s) under held efforts (r, blocks, n_u), and a mask.

        The mask (r,) is False for a failed prediction, whose values are meaningless.
        """
        motions, found = np.zeros((len(s), self.blocks + 1, len(near) + s.shape[1])), np.zeros(len(s), dtype=bool)
        for row, motion in enumerate(motions):
            q, gap = evaluated(self.begin, near, s[row])
            if not gap.item() <= MAX_LOOP_GAP_M:
                continue
            motion[0] = np.concatenate([q.ravel(), v[row]])
            motion[1:] = evaluated(self.motion, motion[0], efforts[row].T)[0].T
            found[row] = np.all(np.isfinite(motion))
        return motions, found

    def linearised(self, motions: np.ndarray, efforts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return A (r, blocks, 2 n_s, 2 n_s) and B (r, blocks, 2 n_s, n_u) of each block, linearised about its middle."""
        n_q, n_s, n = self.mechanism.n_q, self.mechanism.dof, self.blocks
        middle = 0.5 * (motions[:, 1:] + motions[:, :-1])
        slopes = [np.empty((len(efforts), n, n_s, size)) for size in (n_s, n_s, efforts.shape[2])]
        for row, (x, u) in enumerate(zip(middle, efforts, strict=True)):
            for slope, found in zip(slopes, evaluated(self.slopes, x[:, :n_q].T, x[:, n_q:].T, u.T), strict=True):
                slope[row] = found.reshape(n_s, n, -1).transpose(1, 0, 2)
        A, B = held(*(slope.reshape(-1, *slope.shape[2:]) for slope in slopes), self.block_s)
        return A.reshape(-1, n, *A.shape[1:]), B.reshape(-1, n, *B.shape[1:])


def held(by_s: np.ndarray, by_v: np.ndarray, by_u: np.ndarray, block_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return A (n, 2 n_s, 2 n_s) and B (n, 2 n_s, n_u) of (s, v) over blocks [s] with constant acceleration derivatives.

    The exponential's series is truncated at the fourth order, like the Runge-Kutta step of the prediction. If it converges
    slowly, near a singular pose, the exact exponential is used.
    """
    n, n_s, n_u = by_u.shape
    A, B = np.zeros((n, 2 * n_s, 2 * n_s)), np.zeros((n, 2 * n_s, n_u))
    A[:, :n_s, n_s:] = np.eye(n_s)
    A[:, n_s:, :n_s], A[:, n_s:, n_s:], B[:, n_s:] = by_s, by_v, by_u
    stiff = ~((block_s**2 * np.abs(by_s).sum(axis=2) <= 1) & (block_s * np.abs(by_v).sum(axis=2) <= 1)).all(axis=1)
    term = np.eye(2 * n_s) * block_s  # terms of h (1 + h A / 2 + (h A)^2 / 6 + (h A)^3 / 24)
    total = term
    for order in (2, 3, 4):
        term = (block_s / order) * (A @ term)
        total = total + term
    A_block, B_block = np.eye(2 * n_s) + A @ total, total @ B
    if np.any(stiff):
        A_block[stiff], B_block[stiff] = discretise(A[stiff], B[stiff], block_s)
    return A_block, B_block


def predictor(mechanism: Mechanism, blocks: int, block_s: float) -> Predictor:
    """Return the predictor of a mechanism's motions over blocks of a length [s]."""
    n_q, n_s = mechanism.n_q, mechanism.dof
    near, s = ca.MX.sym("near", n_q), ca.MX.sym("s", n_s)
    state, u = ca.MX.sym("state", n_q + n_s), ca.MX.sym("u", mechanism.n_u)

    step = ca.Function("block", [state, u], [runge_kutta(mechanism, state, u, block_s)])
    return Predictor(
        mechanism=mechanism,
        blocks=blocks,
        block_s=block_s,
        begin=ca.Function("begin", [near, s], list(closed_near(mechanism, near, s))),
        motion=step.mapaccum(blocks),
        slopes=mapped(mechanism.dynamics.linearisation, blocks),
    )


def runge_kutta(mechanism: Mechanism, state: ca.MX, effort: ca.MX, duration: ca.MX | float) -> ca.MX:
    """Return (q, v) after a duration [s] under a held effort (n_u,): one Runge-Kutta step of fourth order."""
    n_q = mechanism.n_q

    def slope(x: ca.MX) -> ca.MX:
        return ca.vertcat(*mechanism.dynamics.flow(x[:n_q], x[n_q:], effort))

    k1 = slope(state)
    k2 = slope(state + 0.5 * duration * k1)
    k3 = slope(state + 0.5 * duration * k2)
    k4 = slope(state + duration * k3)
    return state + duration / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
