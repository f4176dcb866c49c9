"""LQR with integral action: the state includes the integral of the position error, which removes steady-state errors.

    i_{k+1} = i_k + T C (s_ref - s_k),   u = u_ref + K_k (e_k, i_k)

(Franklin, Powell & Workman, Digital Control of Dynamic Systems, 1998, 8.5). C selects the integrated positions: all of them
on a fully actuated mechanism, otherwise the set given by `integrable`. The integral is held while a command exceeds an
effort limit (conditional integration; Astrom & Hagglund, Advanced PID Control, 2006, 3.5).
"""

import itertools
from dataclasses import dataclass

import numpy as np

from linkplan.controllers.linearisation import linearise
from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.lqr import Regulator, regulate, regulator
from linkplan.controllers.trackers.tracker import Design, ordered_product
from linkplan.models.actuation.distribution import distribute
from linkplan.models.closure.rank import RANK_TOLERANCE
from linkplan.models.errors import LinkplanError
from linkplan.models.poses.along import is_redundant, sampled


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class IntegralLQR:
    """u = u_ref + K_k (x_ref - x, i), gains K (n, n_u, 2 n_s + n_i); the memory is i (n, n_i) [rad.s or m.s].

    `integrated` (n_i,) are the columns of s with integrated errors. Integration stops at `effort_limit` (n_u, 2) [N.m or N].
    `maps` (n, n_s, n_u) are Gamma^T B along the reference if several efforts are equivalent, which are then distributed
    within the limits; None otherwise.
    """

    reference: SampledReference
    gains: np.ndarray
    integrated: np.ndarray
    effort_limit: np.ndarray
    maps: np.ndarray | None
    name: str = "lqi"

    def start(self, n: int) -> np.ndarray:
        """Return integrals (n, n_i) of zero."""
        return np.zeros((n, len(self.integrated)))

    def step(
        self, k: int, position_rad: np.ndarray, velocity_rad_s: np.ndarray, memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return efforts (n, n_u) [N.m or N] for states (n, n_s), and the next integrals."""
        reference = self.reference
        error = reference.position_rad[k] - position_rad
        state = np.concatenate([error, reference.velocity_rad_s[k] - velocity_rad_s, memory], axis=-1)
        effort = reference.effort[k] + ordered_product(self.gains[k], state)
        if self.maps is not None:
            maps = np.broadcast_to(self.maps[k], (len(effort), *self.maps.shape[1:]))
            effort = distribute(np.einsum("ksu,ku->ks", maps, effort), maps, self.effort_limit, effort)
        low, high = self.effort_limit.T
        free = np.all((effort >= low) & (effort <= high), axis=-1, keepdims=True)
        return effort, np.where(free, memory + reference.period_s * error[..., self.integrated], memory)


def integrable(stiffness: np.ndarray, effort_map: np.ndarray) -> np.ndarray:
    """Return the columns of s whose errors can be integrated together.

    At rest, s'' = A_s s + A_v s' + B u = 0 with s' = 0. Any constant disturbance leaves no error in the outputs C s if the
    other coordinates and u can compensate for it:

        rank [A_s B; C 0] = n_s + n_i.

    The plant then has no transmission zero at zero frequency and no more outputs than inputs (Davison, The Robust Control
    of a Servomechanism Problem, IEEE TAC 21, 1976). Otherwise no feedback stabilises the integrals. Example: a cart-pole
    can hold its cart in place with a leaning pole. It cannot hold its pole upright against a constant push, because the
    cart would have to accelerate for ever. The largest possible number of outputs is chosen. Among sets of this size, the
    set with the best conditioned compensation is chosen.

    Args:
        stiffness: A_s (n_s, n_s), in units of equal cost.
        effort_map: B (n_s, n_u), in the same units.
    """
    n = len(stiffness)
    for count in range(min(n, int(np.linalg.matrix_rank(effort_map, rtol=RANK_TOLERANCE))), 0, -1):
        best, most = None, RANK_TOLERANCE
        for outputs in itertools.combinations(range(n), count):
            rest = np.concatenate([np.delete(stiffness, outputs, axis=1), effort_map], axis=1)
            sizes = np.linalg.svd(rest, compute_uv=False)
            if sizes[-1] / sizes[0] > most:
                best, most = outputs, sizes[-1] / sizes[0]
        if best is not None:
            return np.array(best)
    return np.array([], dtype=int)


def lqi(design: Design) -> IntegralLQR:
    """Return the LQR tracker with integral action of a design.

    The integral of a position error of unit cost over the integral time also has unit cost.

    Raises:
        GainError: if no stabilising gain exists.
        LinkplanError: if no error can be integrated.
    """
    mechanism, reference, errors = design.mechanism, design.reference, design.errors()
    plain, kept = regulator(mechanism, reference, errors)
    n, m, n_u = plain.B.shape
    n_s, half = mechanism.dof, m // 2
    actuated = kept[:half]
    size = np.broadcast_to(errors.position, n_s)[actuated]
    # The last instant, where the Riccati recursion begins.
    A_c, B_c = linearise(mechanism, *reference.part(slice(n - 1, n)).states)
    chosen = integrable(
        A_c[0, n_s + actuated[:, None], actuated] * size / size[:, None],
        B_c[0, n_s + actuated] * errors.effort / size[:, None],
    )
    if not len(chosen):
        raise LinkplanError(
            f"lqi finds no joint of '{mechanism.name}' whose error its actuators can keep at zero at the end of the motion;"
            " lqr needs no integral"
        )
    p = len(chosen)
    A, B = np.zeros((n, m + p, m + p)), np.zeros((n, m + p, n_u))
    A[:, :m, :m], B[:, :m] = plain.A, plain.B
    # The regulator's state is x - x_ref, so the integral decreases with the position.
    A[:, m + np.arange(p), chosen] = -reference.period_s
    A[:, m:, m:] = np.eye(p)
    of_integrals = design.settings.integral_time_s * size[chosen]
    weights = np.concatenate([size, np.broadcast_to(errors.velocity, n_s)[actuated], of_integrals])
    R = np.diag(np.asarray(errors.effort, dtype=float) ** -2.0)
    found: Regulator = regulate(A, B, np.diag(weights**-2.0), R, repeats=reference.cycle is not None)
    gains = np.zeros((n, n_u, 2 * n_s + p))
    # w = -K (x - x_ref, i) = K_x (x_ref - x) - K_i i.
    gains[:, :, kept] = found.gains[:, :, :m]
    gains[:, :, 2 * n_s :] = -found.gains[:, :, m:]
    return IntegralLQR(
        reference=reference,
        gains=gains[np.arange(reference.n) % n],
        integrated=actuated[chosen],
        effort_limit=np.array(design.effort_limit, dtype=float),
        maps=sampled(mechanism.dynamics.effort_map, reference.pose_rad) if is_redundant(mechanism) else None,
    )
