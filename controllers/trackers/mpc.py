"""Model predictive control along a reference: the LQR's cost under effort limits, one quadratic program a control period.

    e_{k+1} = A_k e_k + B_k w_k,   e = x - x_ref,   w = u - u_ref,   low <= u <= high

What is sought is the correction d of the LQR's feedback, w = -K e + d, held over blocks of control periods up to a horizon;
after it the feedback goes on alone. Completing squares, the infinite cost is e_0^T P e_0 + sum d^T S d, S = R + B^T P B: the
terminal cost is the LQR's, the program's Hessian is block diagonal, and while the feedback keeps the limits d = 0 solves it
(closed-loop paradigm; Rossiter, Kouvaritakis & Rice, Automatica 34, 1998). Solved by DAQP (Arnstrom, Bemporad & Axehill,
IEEE Trans. Automatic Control 67, 2022).
"""

from dataclasses import dataclass
from typing import ClassVar

import daqp
import numpy as np

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.linear import times
from linkplan.controllers.trackers.lqr import Errors, regulator
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism

# Blocks up to the horizon.
BLOCKS = 20
# A command this share of the limits' span beyond one is on it.
_ON_LIMIT = 1e-9


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class MPC:
    """u = u_ref - K_k e + d_0, d of the least cost under which predicted efforts keep their limits.

    Along a reference's n instants, from each to the one a block on: closed-loop maps `onward` (n, m, m) and `pushed`
    (n, m, n_u) of a held d, its `price` (n, n_u, n_u), the reference's mean effort `drive` (n, n_u), and which instant that is,
    `after` (n,). `gains` K (n, n_u, m); `feedback` (n, blocks, n_u, m) is -K at each block's start times the closed loop's way
    there; `kept` (m,) are the states of x = (s, v) that are steered.
    """

    reference: SampledReference
    gains: np.ndarray
    onward: np.ndarray
    pushed: np.ndarray
    price: np.ndarray
    drive: np.ndarray
    after: np.ndarray
    feedback: np.ndarray
    kept: np.ndarray
    effort_limit: np.ndarray
    name: str = "mpc"
    batched: ClassVar[bool] = True

    def effort(self, k: int, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Return efforts (..., n_u) [N.m or N] for states (..., n_s)."""
        reference, at = self.reference, k % len(self.after)
        error = np.concatenate([position - reference.position[k], velocity - reference.velocity[k]], axis=-1)
        error = np.atleast_2d(error[..., self.kept])
        effort = reference.effort[k] - times(self.gains[at], error)
        blocks = self._blocks(at)
        low, high = self.effort_limit.T
        slack = _ON_LIMIT * np.where(np.isfinite(high - low), high - low, 0.0)
        # Predicted efforts (n, blocks, n_u) of the feedback alone.
        alone = self.drive[blocks] + times(self.feedback[at], error[:, None, None, :].repeat(len(blocks), axis=1)[..., 0, :])
        beyond = np.flatnonzero(~np.all((alone >= low - slack) & (alone <= high + slack), axis=(1, 2)))
        if len(beyond):
            program = self._program(blocks)
            for row in beyond:
                effort[row] += self._correction(program, alone[row])
        return effort.reshape(*np.shape(position)[:-1], -1)

    def _blocks(self, at: int) -> np.ndarray:
        """Return the instants at which the blocks from an instant on begin."""
        blocks = np.empty(self.feedback.shape[1], dtype=int)
        for b in range(len(blocks)):
            blocks[b], at = at, self.after[at]
        return blocks

    def _program(self, blocks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the Hessian and the matrix (N n_u, N n_u) from corrections to predicted efforts."""
        n_blocks, n_u, m = self.feedback.shape[1:]
        size = n_blocks * n_u
        hessian, efforts = np.zeros((size, size)), np.zeros((size, size))
        state = np.zeros((m, size))
        for b, at in enumerate(blocks):
            rows = slice(b * n_u, (b + 1) * n_u)
            hessian[rows, rows] = self.price[at]
            efforts[rows] = -self.gains[at] @ state
            efforts[rows, rows] += np.eye(n_u)
            state = self.onward[at] @ state
            state[:, rows] += self.pushed[at]
        return hessian, efforts

    def _correction(self, program: tuple[np.ndarray, np.ndarray], alone: np.ndarray) -> np.ndarray:
        """Return d_0 (n_u,) of the program whose predicted efforts without corrections are `alone` (blocks, n_u)."""
        hessian, efforts = program
        n_blocks, n_u = alone.shape
        low, high = np.tile(self.effort_limit, (n_blocks, 1)).T
        found, _, flag, _ = daqp.solve(hessian, np.zeros(len(low)), efforts, high - alone.ravel(), low - alone.ravel())
        # Every effort can be brought within its limits by its own block's correction: there is always a solution.
        return found[:n_u] if flag > 0 else np.full(n_u, np.nan)


def mpc(
    mechanism: Mechanism, reference: SampledReference, errors: Errors, horizon_s: float, effort_limit: np.ndarray
) -> MPC:
    """Return the MPC tracker of a reference.

    Args:
        mechanism: whose reduced dynamics are linearised.
        reference: the motion, sampled.
        errors: what weighs 1 in the cost.
        horizon_s: how far limits are looked at ahead [s]: in blocks of whole control periods, so rounded up.
        effort_limit: (n_u, 2) [N.m or N].

    Raises:
        LinkplanError: when no stabilising gain exists, or a horizon is longer than the motion by far.
    """
    if not (np.isfinite(horizon_s) and horizon_s > 0):
        raise LinkplanError(f"the horizon of mpc is a positive number of seconds, got {horizon_s:g}")
    found, kept = regulator(mechanism, reference, errors)
    A, B, after = found.A, found.B, found.after
    n, m, n_u = B.shape
    loop = A - B @ found.gains
    periods = max(1, int(np.ceil(horizon_s / (BLOCKS * reference.period_s) - 1e-9)))
    onward, pushed = np.tile(np.eye(m), (n, 1, 1)), np.zeros((n, m, n_u))
    price, drive = np.zeros((n, n_u, n_u)), np.zeros((n, n_u))
    at = np.arange(n)
    for _ in range(periods):
        price += found.price[at]
        drive += reference.effort[at] / periods
        onward, pushed = loop[at] @ onward, loop[at] @ pushed + B[at]
        at = after[at]
    feedback = np.empty((n, BLOCKS, n_u, m))
    start, way = np.arange(n), np.tile(np.eye(m), (n, 1, 1))
    for b in range(BLOCKS):
        feedback[:, b] = -found.gains[start] @ way
        way, start = onward[start] @ way, at[start]
    return MPC(
        reference=reference,
        gains=found.gains,
        onward=onward,
        pushed=pushed,
        price=price,
        drive=drive,
        after=at,
        feedback=feedback,
        kept=kept,
        effort_limit=np.array(effort_limit, dtype=float),
    )
