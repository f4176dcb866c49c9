"""LQR with integral action: the position error's integral joins the state, so that a constant disturbance leaves no error.

    i_{k+1} = i_k + T (s_ref - s_k),   u = u_ref + K_k (e_k, i_k)

(Franklin, Powell & Workman, Digital Control of Dynamic Systems, 1998, 8.5). The integral stands still while a command is
beyond an effort limit (conditional integration; Astrom & Hagglund, Advanced PID Control, 2006, 3.5).
"""

from dataclasses import dataclass

import numpy as np

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.linear import times
from linkplan.controllers.trackers.lqr import Errors, Regulator, regulate, regulator
from linkplan.models.mechanism import Mechanism


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class IntegralLQR:
    """u = u_ref + K_k (x_ref - x, i), gains K (n, n_u, 2 n_s + n_s); the memory is i (n, n_s) [rad.s or m.s].

    `effort_limit` (n_u, 2) [N.m or N] is where integration stops.
    """

    reference: SampledReference
    gains: np.ndarray
    effort_limit: np.ndarray
    name: str = "lqi"

    def start(self, n: int) -> np.ndarray:
        """Return integrals (n, n_s) of zero."""
        return np.zeros((n, self.reference.position.shape[1]))

    def step(self, k: int, position: np.ndarray, velocity: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return efforts (n, n_u) [N.m or N] for states (n, n_s), and the next integrals."""
        reference = self.reference
        error = reference.position[k] - position
        state = np.concatenate([error, reference.velocity[k] - velocity, memory], axis=-1)
        effort = reference.effort[k] + times(self.gains[k], state)
        low, high = self.effort_limit.T
        free = np.all((effort >= low) & (effort <= high), axis=-1, keepdims=True)
        return effort, np.where(free, memory + reference.period_s * error, memory)


def integral_lqr(
    mechanism: Mechanism, reference: SampledReference, errors: Errors, integral_time_s: float, effort_limit: np.ndarray
) -> IntegralLQR:
    """Return the LQR tracker with integral action of a reference.

    Args:
        mechanism: whose reduced dynamics are linearised.
        reference: the motion, sampled.
        errors: what weighs 1; an integral weighs 1 that a position error of 1 gathers in the integral time.
        integral_time_s: that time [s].
        effort_limit: (n_u, 2) [N.m or N].

    Raises:
        LinkplanError: when no stabilising gain exists.
    """
    plain, kept = regulator(mechanism, reference, errors)
    n, m, n_u = plain.B.shape
    n_s, half = mechanism.dof, m // 2
    A, B = np.zeros((n, m + half, m + half)), np.zeros((n, m + half, n_u))
    A[:, :m, :m], B[:, :m] = plain.A, plain.B
    # In terms of x - x_ref, as the regulator has it: the integral falls as the position rises.
    A[:, m:, :half] = -reference.period_s * np.eye(half)
    A[:, m:, m:] = np.eye(half)
    size = np.broadcast_to(errors.position, n_s)[kept[:half]]
    weights = np.concatenate([size, np.broadcast_to(errors.velocity, n_s)[kept[:half]], integral_time_s * size])
    R = np.diag(np.asarray(errors.effort, dtype=float) ** -2.0)
    found: Regulator = regulate(A, B, np.diag(weights**-2.0), R, repeats=reference.cycle is not None)
    gains = np.zeros((n, n_u, 3 * n_s))
    # w = -K (x - x_ref, i) = K_x (x_ref - x) - K_i i.
    gains[:, :, kept] = found.gains[:, :, :m]
    gains[:, :, 2 * n_s + kept[:half]] = -found.gains[:, :, m:]
    return IntegralLQR(
        reference=reference,
        gains=gains[np.arange(reference.n) % n],
        effort_limit=np.array(effort_limit, dtype=float),
    )
