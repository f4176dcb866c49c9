"""LQR with integral action: the position error's integral joins the state, so that a constant disturbance leaves no error.

    i_{k+1} = i_k + T C (s_ref - s_k),   u = u_ref + K_k (e_k, i_k)

(Franklin, Powell & Workman, Digital Control of Dynamic Systems, 1998, 8.5). C takes the positions that are integrated: all
where actuators move every degree of freedom, else as many as they move (`integrable`). The integral stands still while a
command is beyond an effort limit (conditional integration; Astrom & Hagglund, Advanced PID Control, 2006, 3.5).
"""

import itertools
from dataclasses import dataclass

import numpy as np

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.linear import times
from linkplan.controllers.trackers.lqr import Errors, Regulator, linearise, regulate, regulator
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism

# Weighed singular values below this share of the largest are zero: derivatives of the reduced dynamics are exact to 1e-12.
_RANK = 1e-9


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class IntegralLQR:
    """u = u_ref + K_k (x_ref - x, i), gains K (n, n_u, 2 n_s + n_i); the memory is i (n, n_i) [rad.s or m.s].

    `integrated` (n_i,) are the columns of s whose errors are integrated; `effort_limit` (n_u, 2) [N.m or N] is where
    integration stops.
    """

    reference: SampledReference
    gains: np.ndarray
    integrated: np.ndarray
    effort_limit: np.ndarray
    name: str = "lqi"

    def start(self, n: int) -> np.ndarray:
        """Return integrals (n, n_i) of zero."""
        return np.zeros((n, len(self.integrated)))

    def step(self, k: int, position: np.ndarray, velocity: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return efforts (n, n_u) [N.m or N] for states (n, n_s), and the next integrals."""
        reference = self.reference
        error = reference.position[k] - position
        state = np.concatenate([error, reference.velocity[k] - velocity, memory], axis=-1)
        effort = reference.effort[k] + times(self.gains[k], state)
        low, high = self.effort_limit.T
        free = np.all((effort >= low) & (effort <= high), axis=-1, keepdims=True)
        return effort, np.where(free, memory + reference.period_s * error[..., self.integrated], memory)


def integrable(stiffness: np.ndarray, effort_map: np.ndarray) -> np.ndarray:
    """Return the columns of s whose errors can be integrated together.

    With s' = 0 in s'' = A_s s + A_v s' + B u, a constant disturbance leaves no error in the outputs C s where the rest of s
    and u can make up for it, whatever it is:

        rank [A_s B; C 0] = n_s + n_i,

    no transmission zero at s = 0 and no more outputs than inputs (Davison, The Robust Control of a Servomechanism Problem,
    IEEE TAC 21, 1976). Otherwise no feedback makes the integrals stable. A cart-pole's cart can be kept in place, by a
    leaning pole; its pole cannot be kept upright against a push anywhere, which takes a cart that accelerates for ever.
    There are always as many such outputs as efforts that are independent; of several sets the one whose disturbances the
    rest makes up for with least, in the units given.

    Args:
        stiffness: A_s (n_s, n_s), in units of what weighs alike.
        effort_map: B (n_s, n_u), the same.
    """
    n = len(stiffness)
    for count in range(min(n, int(np.linalg.matrix_rank(effort_map, rtol=_RANK))), 0, -1):
        best, most = None, _RANK
        for outputs in itertools.combinations(range(n), count):
            rest = np.concatenate([np.delete(stiffness, outputs, axis=1), effort_map], axis=1)
            sizes = np.linalg.svd(rest, compute_uv=False)
            if sizes[-1] / sizes[0] > most:
                best, most = outputs, sizes[-1] / sizes[0]
        if best is not None:
            return np.array(best)
    return np.array([], dtype=int)


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
        LinkplanError: when no stabilising gain exists, or no error can be kept at zero.
    """
    plain, kept = regulator(mechanism, reference, errors)
    n, m, n_u = plain.B.shape
    n_s, half = mechanism.dof, m // 2
    steered = kept[:half]
    size = np.broadcast_to(errors.position, n_s)[steered]
    # Where the motion rests, or a cycle's last instant: there the Riccati recursion begins.
    last = slice(n - 1, n)
    A_c, B_c = linearise(mechanism, reference.pose[last], reference.velocity[last], reference.effort[last])
    chosen = integrable(
        A_c[0, n_s + steered[:, None], steered] * size / size[:, None], B_c[0, n_s + steered] * errors.effort / size[:, None]
    )
    if not len(chosen):
        raise LinkplanError(
            f"lqi finds no joint of '{mechanism.name}' whose error its actuators can keep at zero where the motion ends; lqr"
            " does without an integral"
        )
    p = len(chosen)
    A, B = np.zeros((n, m + p, m + p)), np.zeros((n, m + p, n_u))
    A[:, :m, :m], B[:, :m] = plain.A, plain.B
    # In terms of x - x_ref, as the regulator has it: the integral falls as the position rises.
    A[:, m + np.arange(p), chosen] = -reference.period_s
    A[:, m:, m:] = np.eye(p)
    weights = np.concatenate([size, np.broadcast_to(errors.velocity, n_s)[steered], integral_time_s * size[chosen]])
    R = np.diag(np.asarray(errors.effort, dtype=float) ** -2.0)
    found: Regulator = regulate(A, B, np.diag(weights**-2.0), R, repeats=reference.cycle is not None)
    gains = np.zeros((n, n_u, 2 * n_s + p))
    # w = -K (x - x_ref, i) = K_x (x_ref - x) - K_i i.
    gains[:, :, kept] = found.gains[:, :, :m]
    gains[:, :, 2 * n_s :] = -found.gains[:, :, m:]
    return IntegralLQR(
        reference=reference,
        gains=gains[np.arange(reference.n) % n],
        integrated=steered[chosen],
        effort_limit=np.array(effort_limit, dtype=float),
    )
