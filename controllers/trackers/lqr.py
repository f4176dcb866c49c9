"""Time-varying discrete LQR along a reference, in the reduced coordinates.

    x = (s, v),   x_{k+1} = A_k x_k + B_k u_k,   u = u_ref + K_k (x_ref - x)

A_k, B_k hold the reduced dynamics' derivatives at t_k over one control period (zero-order hold); K_k comes from the
Riccati recursion backward in time (Anderson & Moore, Optimal Control, 1990, 2.4), from the stationary solution at the end
of a motion, or over a periodic motion again and again until it repeats itself.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.linalg

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.linear import times
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism

# A periodic Riccati solution counts as found when a cycle changes it by less than this, relative; cycles before giving up.
_CYCLE_TOLERANCE = 1e-9
_MAX_CYCLES = 200


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class LQR:
    """u = u_ref + K_k (x_ref - x), with gains K (n, n_u, 2 n_s)."""

    reference: SampledReference
    gains: np.ndarray
    name: str = "lqr"
    batched: ClassVar[bool] = True

    def effort(self, k: int, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Return efforts (..., n_u) [N.m or N] for states (..., n_s)."""
        reference = self.reference
        error = np.concatenate([reference.position[k] - position, reference.velocity[k] - velocity], axis=-1)
        return reference.effort[k] + times(self.gains[k], error)


def linearise(
    mechanism: Mechanism, pose: np.ndarray, velocity: np.ndarray, effort: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return A (n, 2 n_s, 2 n_s) and B (n, 2 n_s, n_u) of x' = A x + B u about states along a motion.

    Exact derivatives of the reduced model along the closed chain; no simulator is differenced.
    """
    n, n_s, n_u = len(pose), mechanism.dof, mechanism.n_u
    function = mechanism.dynamics.linearisation
    outputs = function.map(n)(pose.T, velocity.T, effort.T)
    by_s, by_v, by_u = (np.array(output).reshape(n_s, n, -1).transpose(1, 0, 2) for output in outputs)
    A, B = np.zeros((n, 2 * n_s, 2 * n_s)), np.zeros((n, 2 * n_s, n_u))
    A[:, :n_s, n_s:] = np.eye(n_s)
    A[:, n_s:, :n_s], A[:, n_s:, n_s:], B[:, n_s:] = by_s, by_v, by_u
    return A, B


def discretise(A: np.ndarray, B: np.ndarray, period_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the zero-order-hold equivalents of A (n, m, m) and B (n, m, n_u) over a period [s]."""
    n, m, n_u = B.shape
    block = np.zeros((n, m + n_u, m + n_u))
    block[:, :m, :m], block[:, :m, m:] = A, B
    power = scipy.linalg.expm(block * period_s)
    return power[:, :m, :m], power[:, :m, m:]


def lqr(
    mechanism: Mechanism,
    reference: SampledReference,
    *,
    position_weight: float | np.ndarray,
    velocity_weight: float | np.ndarray,
    effort_weight: np.ndarray,
) -> LQR:
    """Return the LQR tracker of a reference.

    Args:
        mechanism: whose reduced dynamics are linearised.
        reference: the motion, sampled.
        position_weight: position error [rad or m] that weighs 1, one for all or (n_s,).
        velocity_weight: velocity error [rad/s or m/s] that weighs 1, one for all or (n_s,).
        effort_weight: effort (n_u,) that weighs 1, its limit as a rule.

    Raises:
        LinkplanError: when no stabilising gain exists.
    """
    n_s = mechanism.dof
    A, B = linearise(mechanism, reference.pose, reference.velocity, reference.effort)
    # A passive degree of freedom, as a rod's spin between two balls, cannot be controlled: it stays out of the state.
    steered = np.array([int(i) not in mechanism.passive_dofs for i in mechanism.independent])
    kept = np.flatnonzero(np.tile(steered, 2))
    A, B = discretise(A[:, kept[:, None], kept], B[:, kept], reference.period_s)
    errors = [np.broadcast_to(weight, steered.shape)[steered] for weight in (position_weight, velocity_weight)]
    Q = np.diag(np.concatenate(errors) ** -2.0)
    R = np.diag(np.asarray(effort_weight, dtype=float) ** -2.0)
    n = reference.cycle if reference.cycle is not None and reference.cycle <= reference.n else reference.n
    try:
        P = scipy.linalg.solve_discrete_are(A[n - 1], B[n - 1], Q, R)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise LinkplanError(f"LQR has no stabilising gain at the end of the motion: {error}") from error
    gains, P_next = _backward(A[:n], B[:n], Q, R, P)
    cycles = 0
    while reference.cycle is not None and np.abs(P_next - P).max() > _CYCLE_TOLERANCE * np.abs(P).max():
        if (cycles := cycles + 1) > _MAX_CYCLES:
            raise LinkplanError("LQR found no gain that repeats with the motion: the periodic Riccati recursion diverges")
        P = P_next
        gains, P_next = _backward(A[:n], B[:n], Q, R, P)
    full = np.zeros((n, mechanism.n_u, 2 * n_s))
    full[:, :, kept] = gains
    return LQR(reference=reference, gains=full[np.arange(reference.n) % n])


def _backward(A, B, Q, R, P) -> tuple[np.ndarray, np.ndarray]:
    """Return the gains (n, n_u, m) of the Riccati recursion from P at the end, and P at the beginning."""
    gains = np.empty((len(A), B.shape[2], A.shape[1]))
    for k in range(len(A) - 1, -1, -1):
        BP = B[k].T @ P
        gains[k] = np.linalg.solve(R + BP @ B[k], BP @ A[k])
        P = Q + A[k].T @ P @ (A[k] - B[k] @ gains[k])
        P = 0.5 * (P + P.T)
    return gains, P
