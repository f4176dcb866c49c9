"""Time-varying discrete LQR along a reference, in the reduced coordinates.

    x = (s, v),   x_{k+1} = A_k x_k + B_k u_k,   u = u_ref + K_k (x_ref - x)

A_k and B_k come from the reduced dynamics' derivatives at t_k, held over one control period (zero-order hold). Where an
implicit integrator adds a servo's gain and damping to the inertia of every step, they are those of MuJoCo's steps: the
effect of an effort may be a fraction of what the continuous motion shows. K_k comes from the backward Riccati recursion
(Anderson & Moore, Optimal Control, 1990, 2.4). It starts from the infinite-horizon solution: for the last instant if a
motion ends at rest, for the whole cycle if it repeats.
"""

import functools
from dataclasses import dataclass

import numpy as np

from linkplan.controllers.integrator import simulates_servos
from linkplan.controllers.linearisation import discretise, linearise
from linkplan.controllers.reference import SampledReference
from linkplan.controllers.sampling import sampling, simulated
from linkplan.controllers.trackers.tracker import Design, Errors, StateFeedback
from linkplan.models.errors import GainError
from linkplan.models.mechanism import Mechanism

# Matrices A, G = B R^-1 B^T and Q (m, m) of an instant: the cost P after it is Q + A^T P (I + G P)^-1 A before it. Several
# instants in turn have such matrices, too.
_Span = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Regulator:
    """Optimal feedback w_k = -K_k e_k for e_{k+1} = A_k e_k + B_k w_k, at instants k = 0 to n - 1.

    `A` (n, m, m), `B` (n, m, n_u), `gains` K (n, n_u, m). `cost` P (n, m, m): e^T P e is the optimal cost to go. `Q` and `R`
    are the cost matrices of one period. `after` (n,) is the index of the following instant: the last instant is followed by
    itself or, in a cycle, by the first instant.
    """

    A: np.ndarray
    B: np.ndarray
    gains: np.ndarray
    cost: np.ndarray
    Q: np.ndarray
    R: np.ndarray
    after: np.ndarray


@np.errstate(over="ignore", invalid="ignore")  # where no gain exists, the cost grows without bound
def regulate(
    A: np.ndarray, B: np.ndarray, Q: np.ndarray, R: np.ndarray, *, repeats: bool, end: np.ndarray | None = None
) -> Regulator:
    """Return the optimal feedback for the cost sum e^T Q e + w^T R w, over a motion that ends at rest or repeats.

    `end` (m, m) is the cost of what comes after a motion that does neither.

    Raises:
        GainError: if no stabilising gain exists.
    """
    P = end
    if P is None:
        spans = [(A_k, B_k @ np.linalg.solve(R, B_k.T), Q) for A_k, B_k in zip(A, B, strict=True)]
        P = _stationary_cost(functools.reduce(_joined, spans) if repeats else spans[-1])
    gains, cost = np.empty((len(A), B.shape[2], A.shape[1])), np.empty(A.shape)
    for k in range(len(A) - 1, -1, -1):  # the Riccati recursion from the end
        BP = B[k].T @ P
        gains[k] = np.linalg.solve(R + BP @ B[k], BP @ A[k])
        P = Q + A[k].T @ P @ (A[k] - B[k] @ gains[k])
        cost[k] = P = 0.5 * (P + P.T)
    after = np.arange(1, len(A) + 1)
    after[-1] = 0 if repeats else len(A) - 1
    return Regulator(A=A, B=B, gains=gains, cost=cost, Q=Q, R=R, after=after)


def regulator(
    mechanism: Mechanism, reference: SampledReference, errors: Errors, end: np.ndarray | None = None
) -> tuple[Regulator, np.ndarray]:
    """Return the optimal feedback along a reference, and the indices (m,) of x = (s, v) in its state.

    `end` (2 n_s, 2 n_s) is the cost of what comes after it; without it the motion ends at rest or repeats.

    A passive degree of freedom, such as the spin of a rod between two ball joints, is uncontrollable and left out.
    """
    pose, velocity, effort, *forces = reference.part(slice(repeated(reference))).states
    kept = np.flatnonzero(np.tile(mechanism.actuated, 2))
    if simulates_servos(mechanism):
        A, B, _ = simulated(mechanism, pose, velocity, effort, sampling(mechanism, reference.period_s), *forces)
        A, B = A[:, kept[:, None], kept], B[:, kept]
    else:
        A, B = linearise(mechanism, pose, velocity, effort, *forces)
        A, B = discretise(A[:, kept[:, None], kept], B[:, kept], reference.period_s)
    sizes = [np.broadcast_to(weight, mechanism.dof)[mechanism.actuated] for weight in (errors.position, errors.velocity)]
    Q = np.diag(np.concatenate(sizes) ** -2.0)
    R = np.diag(np.asarray(errors.effort, dtype=float) ** -2.0)
    end = None if end is None else end[np.ix_(kept, kept)]
    return regulate(A, B, Q, R, repeats=reference.cycle is not None, end=end), kept


def repeated(reference: SampledReference) -> int:
    """Return the number of different instants of a reference: one cycle, or all."""
    return reference.n if reference.cycle is None else min(reference.cycle, reference.n)


def lqr(design: Design) -> StateFeedback:
    """Return the LQR tracker of a design, by the reduced dynamics linearised along its reference.

    Raises:
        GainError: if no stabilising gain exists.
    """
    found, _ = regulator(design.mechanism, design.reference, design.errors())
    return regulated(design, found)


def regulated(design: Design, found: Regulator) -> StateFeedback:
    """Return the tracker of a design with a regulator's gains along its reference."""
    reference, mechanism = design.reference, design.mechanism
    full = np.zeros((len(found.gains), mechanism.n_u, 2 * mechanism.dof))
    full[:, :, np.tile(mechanism.actuated, 2)] = found.gains
    gains = full[np.arange(reference.n) % len(full)]
    return StateFeedback(reference=reference, gains=gains, name="lqr", feedforward=True)


def _joined(first: _Span, then: _Span) -> _Span:
    """Return the span that consists of two consecutive spans."""
    (A, G, P), (A_then, G_then, P_then) = first, then
    A_half, G_half = np.hsplit(np.linalg.solve(np.eye(len(A)) + G @ P_then, np.hstack([A, G])), 2)
    G, P = G_then + A_then @ G_half @ A_then.T, P + A.T @ P_then @ A_half
    return A_then @ A_half, 0.5 * (G + G.T), 0.5 * (P + P.T)


def _stationary_cost(span: _Span) -> np.ndarray:
    """Return the cost P (m, m) of a span that repeats for ever, by doubling: step k has the cost of 2^k spans.

    The algorithm is structure-preserving doubling (Chu, Fan, Lin & Wang, Int. J. Control 77, 2004). QZ, which scipy uses,
    fails where many eigenvalues of A are next to 1, as those of a robot with slow feedback are.

    Raises:
        GainError: if the cost does not converge, because no gain stabilises the system.
    """
    for _ in range(40):  # a horizon of 2^40 periods of 0.1 ms is three years
        before, span = span[2], _joined(span, span)
        P = span[2]
        if not np.all(np.isfinite(P)):
            break
        if np.abs(P - before).max() <= np.finfo(float).eps * np.abs(P).max():
            return P
    raise GainError(
        "LQR has no stabilising gain at the end or over a cycle of the motion: no effort stabilises a part of it"
    )
