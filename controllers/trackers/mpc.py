"""Model predictive control along a reference: the LQR's cost under effort limits, one quadratic program per period.

    minimise sum e^T Q e + w^T R w + e_N^T P e_N,   e = x - x_ref,   w = u - u_ref,   low <= u <= high

The terminal cost P is the LQR's cost to go. If the predicted LQR efforts keep the limits, the LQR feedback is therefore the
solution and is used directly. Otherwise efforts that are held over blocks of control periods are corrected once per period
(real-time iteration; Diehl, Bock & Schloeder, SIAM J. Control Optim. 43, 2005). The previous efforts give the predicted
motion from the measured state, and the reduced dynamics are linearised along it. DAQP solves the quadratic program
(Arnstrom, Bemporad & Axehill, IEEE Trans. Automatic Control 67, 2022).
"""

from dataclasses import dataclass

import daqp
import numpy as np

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.linear import times
from linkplan.controllers.trackers.lqr import Errors, Regulator, regulator
from linkplan.controllers.trackers.prediction import Predictor, predictor
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism

# Number of blocks of constant effort in the horizon.
HORIZON_BLOCKS = 20


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class MPC:
    """The effort of least cost whose prediction keeps the limits. The memory (n, blocks n_u) holds the previous efforts.

    `alone` (n, blocks, n_u, m): map from an error to the LQR's corrections at the beginning of each block. `ahead`
    (n, blocks + 1): instants at which the blocks begin. `drive` (n, n_u): mean reference effort of a block that begins at
    an instant. `kept` (m,): indices of the controlled states in x = (s, v). The memory is NaN while the LQR acts.
    """

    reference: SampledReference
    regulator: Regulator
    alone: np.ndarray
    ahead: np.ndarray
    drive: np.ndarray
    kept: np.ndarray
    periods: int
    predictor: Predictor
    effort_limit: np.ndarray
    name: str = "mpc"

    def start(self, n: int) -> np.ndarray:
        """Return the initial memory (n, blocks n_u), NaN: the LQR acts."""
        return np.full((n, self.drive.shape[1] * HORIZON_BLOCKS), np.nan)

    def step(self, k: int, position: np.ndarray, velocity: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return efforts (n, n_u) [N.m or N] for states (n, n_s), and the efforts of the blocks."""
        reference, at = self.reference, k % len(self.ahead)
        error = np.concatenate([position - reference.position[k], velocity - reference.velocity[k]], axis=-1)[:, self.kept]
        effort = reference.effort[k] - times(self.regulator.gains[at], error)
        low, high = self.effort_limit.T
        slack = 1e-9 * np.where(np.isfinite(high - low), high - low, 0.0)
        predicted = self.drive[self.ahead[at, :-1]] + np.stack([times(K, error) for K in self.alone[at]], axis=1)
        beyond = ~np.all((predicted >= low - slack) & (predicted <= high + slack), axis=(1, 2))
        next_memory = self.start(len(position))
        rows = np.flatnonzero(beyond)
        if len(rows):
            last = memory[rows].reshape(len(rows), HORIZON_BLOCKS, -1)
            before = np.where(np.isnan(last), np.clip(predicted[rows], low, high), last)
            found, better = self._corrected(k, position[rows], velocity[rows], before)
            next_memory[rows] = np.where(better[:, None], found.reshape(len(rows), -1), np.nan)
            effort[rows[better]] = found[better, 0]
        return effort, next_memory

    def _corrected(self, k: int, s: np.ndarray, v: np.ndarray, efforts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return corrected efforts (r, blocks, n_u) from states (r, n_s), and a mask (r,) of the successful corrections.

        A correction fails if the motion cannot be predicted or linearised, for example beyond the poses where the loop
        closes.
        """
        reference, kept, ahead = self.reference, self.kept, self.ahead[k % len(self.ahead)]
        motion, found = self.predictor.motions_of(reference.pose[k], s, v, efforts)
        better, rows = efforts.copy(), np.flatnonzero(found)
        if not len(rows):
            return better, found
        motion, efforts = motion[rows], efforts[rows]
        # If a cycle advances by whole turns, subtract the turns made so far.
        passed = reference.position[k] - reference.position[k % len(self.ahead)]
        mechanism = self.predictor.mechanism
        x = np.concatenate([motion[:, 1:, mechanism.independent] - passed, motion[:, 1:, mechanism.n_q :]], axis=2)
        wanted = np.concatenate([reference.position[ahead[1:]], reference.velocity[ahead[1:]]], axis=1)
        weights = self.periods * self.regulator.Q, self.periods * self.regulator.R, self.regulator.cost[ahead[-1]]
        with np.errstate(over="ignore", invalid="ignore"):  # `_solved` refuses infinite numbers
            A, B = self.predictor.linearised(motion, efforts)
            A, B = A[:, :, kept[:, None], kept], B[:, :, kept]
            programs = _programs(A, B, (x - wanted)[:, :, kept], efforts - self.drive[ahead[:-1]], *weights)
        rooms = self.effort_limit - efforts[:, :, :, None]
        for row, hessian, gradient, room in zip(rows, *programs, rooms, strict=True):
            correction = _solved(hessian, gradient, room)
            found[row] = correction is not None
            if correction is not None:
                better[row] += correction
        return better, found


def _programs(A, B, e, w, Q, R, P) -> tuple[np.ndarray, np.ndarray]:
    """Return Hessians (r, N n_u, N n_u) and gradients (r, N n_u) in corrections d (N, n_u) of efforts.

    dx_{b+1} = A_b dx_b + B_b d_b. The cost penalises e + dx (r, N, m), with P for the last block, and w + d (r, N, n_u).
    Rows do not influence each other, because matmul multiplies the matrices of a stack one by one.
    """
    r, n, m, n_u = B.shape
    states = np.zeros((r, n, m, n * n_u))
    for b in range(n):
        if b:
            states[:, b, :, : b * n_u] = A[:, b] @ states[:, b - 1, :, : b * n_u]
        states[:, b, :, b * n_u : (b + 1) * n_u] = B[:, b]
    weighed = np.matmul(Q, states)
    weighed[:, -1] = P @ states[:, -1]
    turned = weighed.reshape(r, n * m, -1).transpose(0, 2, 1)
    hessian = turned @ states.reshape(r, n * m, -1) + np.kron(np.eye(n), R)
    return hessian, (turned @ e.reshape(r, -1, 1))[:, :, 0] + (w @ R).reshape(r, -1)


def _solved(hessian: np.ndarray, gradient: np.ndarray, room: np.ndarray) -> np.ndarray | None:
    """Return the optimal corrections (N, n_u) within the bounds `room` (N, n_u, 2), or None if the solver fails."""
    if not (np.isfinite(hessian).all() and np.isfinite(gradient).all()):
        return None
    low, high = (np.ascontiguousarray(side) for side in room.reshape(-1, 2).T)  # DAQP ignores strides
    found, _, flag, _ = daqp.solve(np.ascontiguousarray(hessian), gradient, np.empty((0, len(gradient))), high, low)
    return found.reshape(room.shape[:2]) if flag > 0 and np.isfinite(found).all() else None


def mpc(
    mechanism: Mechanism, reference: SampledReference, errors: Errors, horizon_s: float, effort_limit: np.ndarray
) -> MPC:
    """Return the MPC tracker of a reference.

    Args:
        mechanism: its reduced dynamics are the prediction model.
        reference: the sampled motion.
        errors: errors and efforts of unit cost.
        horizon_s: length of the prediction [s], rounded up to blocks of whole control periods.
        effort_limit: (n_u, 2) [N.m or N].

    Raises:
        LinkplanError: if no stabilising gain exists, or for an invalid horizon.
    """
    if not (np.isfinite(horizon_s) and horizon_s > 0):
        raise LinkplanError(f"the horizon of mpc is a positive number of seconds, got {horizon_s:g}")
    found, kept = regulator(mechanism, reference, errors)
    n, m, n_u = found.B.shape
    loop = found.A - found.B @ found.gains
    periods = max(1, int(np.ceil(horizon_s / (HORIZON_BLOCKS * reference.period_s) - 1e-9)))
    way, drive, at = np.tile(np.eye(m), (n, 1, 1)), np.zeros((n, n_u)), np.arange(n)
    for _ in range(periods):
        drive += reference.effort[at] / periods
        way, at = loop[at] @ way, found.after[at]
    alone, ahead = np.empty((n, HORIZON_BLOCKS, n_u, m)), np.empty((n, HORIZON_BLOCKS + 1), dtype=int)
    ahead[:, 0], so_far = np.arange(n), np.tile(np.eye(m), (n, 1, 1))
    for b in range(HORIZON_BLOCKS):
        here = ahead[:, b]
        alone[:, b] = -found.gains[here] @ so_far
        so_far, ahead[:, b + 1] = way[here] @ so_far, at[here]
    return MPC(
        reference=reference,
        regulator=found,
        alone=alone,
        ahead=ahead,
        drive=drive,
        kept=kept,
        periods=periods,
        predictor=predictor(mechanism, HORIZON_BLOCKS, periods * reference.period_s),
        effort_limit=np.array(effort_limit, dtype=float),
    )
