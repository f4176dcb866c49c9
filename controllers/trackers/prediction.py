"""Motions that a tracker predicts: the reduced dynamics under held efforts from a state, and their linearisation."""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.controllers.trackers.closing import CLOSED_NEAR_M, closed_near
from linkplan.controllers.trackers.lqr import discretise
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import evaluated, mapped


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Predictor:
    """Motions over `blocks` blocks of `block_s` [s] each, one Runge-Kutta step of fourth order a block."""

    mechanism: Mechanism
    blocks: int
    block_s: float
    begin: ca.Function  # q near, s -> q, gap [m]
    motion: ca.Function  # (q, v), efforts of the blocks -> (q, v) after each

    def motion_of(self, near: np.ndarray, s: np.ndarray, v: np.ndarray, efforts: np.ndarray) -> np.ndarray | None:
        """Return (q, v) (blocks + 1, n_q + n_s) from a state under held efforts (blocks, n_u); None where it is lost."""
        q, gap = evaluated(self.begin, near, s)
        if not gap.item() <= CLOSED_NEAR_M:
            return None
        state = np.concatenate([q.ravel(), v])
        (after,) = evaluated(self.motion, state, efforts.T)
        motion = np.concatenate([state[None], after.T])
        return motion if np.all(np.isfinite(motion)) else None

    def linearised(self, motion: np.ndarray, efforts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return A (blocks, 2 n_s, 2 n_s) and B (blocks, 2 n_s, n_u) of each block of a motion, about its middle."""
        mechanism, n = self.mechanism, self.blocks
        n_q, n_s = mechanism.n_q, mechanism.dof
        middle = 0.5 * (motion[1:] + motion[:-1])
        function = mapped(mechanism.dynamics.linearisation, n)
        outputs = evaluated(function, middle[:, :n_q].T, middle[:, n_q:].T, efforts.T)
        by_s, by_v, by_u = (x.reshape(n_s, n, -1).transpose(1, 0, 2) for x in outputs)
        A, B = np.zeros((n, 2 * n_s, 2 * n_s)), np.zeros((n, 2 * n_s, efforts.shape[1]))
        A[:, :n_s, n_s:] = np.eye(n_s)
        A[:, n_s:, :n_s], A[:, n_s:, n_s:], B[:, n_s:] = by_s, by_v, by_u
        return discretise(A, B, self.block_s)


def predictor(mechanism: Mechanism, blocks: int, block_s: float) -> Predictor:
    """Return what predicts a mechanism's motions over blocks of a length [s]."""
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
