"""The reduced dynamics linearised along a motion, x' = A x + B u with x = (s, v), and over a period of held effort."""

import numpy as np
import scipy.linalg

from linkplan.models.mechanism import Mechanism


def linearise(
    mechanism: Mechanism, pose: np.ndarray, velocity: np.ndarray, effort: np.ndarray, *forces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return A (n, 2 n_s, 2 n_s) and B (n, 2 n_s, n_u) of x' = A x + B u about n states.

    They are the exact derivatives of the reduced model; no simulator is differenced. `forces` are those of
    `Mechanism.forces_at`; without them, forces over time do not act.
    """
    n, n_s, n_u = len(pose), mechanism.dof, mechanism.n_u
    function = (mechanism.forced if forces else mechanism.dynamics).linearisation
    outputs = function.map(n)(pose.T, velocity.T, effort.T, *(w.T for w in forces))
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
