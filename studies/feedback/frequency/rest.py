"""Feedback loops at rest: the response to a small step of the reference, and the stiffness against a steady effort.

About an operating point at rest, with gains K on the positions' errors, A of the accelerations by the positions and B by the
efforts, small steps r of the reference and steady efforts d on the coordinates move the mechanism until

    (B K - A) s = B K r + M^-1 d

so weight and springs (A) reduce or increase the stiffness of the gains.
"""

import numpy as np

from linkplan.studies.feedback.frequency.feedback_loops import OperatingPoint, channel_effort

# A joint must settle this near to a small step of its reference, in spite of weight and springs.
LEAST_RESPONSE_AT_REST = 0.95


def rest_response(point: OperatingPoint, gains: np.ndarray, channel: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the response and the stiffness at rest (n,) of a coordinate's loop for gains (n, n_u, 2 n_s).

    The loops of the other coordinates are closed. The response is the complementary sensitivity at frequency zero: 0.95
    means that the joint settles at 95 % of a small step. The stiffness [N.m/rad or N/m] is a steady effort on the coordinate
    over the steady error that it causes, while the other coordinates are free to move. Both are meaningless for an
    unstable loop.
    """
    n_s, actuated = point.mechanism.dof, np.flatnonzero(point.mechanism.actuated).tolist()
    A, B = (matrix[n_s:][actuated] for matrix in point.linearised())
    A, K = A[:, actuated], gains[:, :, actuated]
    read, push = channel_effort(point, channel)
    i, inertia = actuated.index(channel), point.inertia[np.ix_(actuated, actuated)]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        inverse = _inverses(B @ K - A)
        response = np.einsum("u,nus,ns->n", read, K, inverse @ (B @ push))
        stiffness = 1.0 / (inverse @ np.linalg.inv(inertia))[:, i, i]
    return response, stiffness


def passive_stiffness(point: OperatingPoint) -> np.ndarray:
    """Return the stiffness (n_s, n_s) [N.m/rad or N/m] that weight and springs give the coordinates about a point."""
    n_s = point.mechanism.dof
    return -point.inertia @ point.linearised()[0][n_s:, :n_s]


def _inverses(matrices: np.ndarray) -> np.ndarray:
    """Return the inverses of matrices (n, m, m), infinite for a singular one, with which nothing holds the mechanism."""
    regular = np.abs(np.linalg.det(matrices)) > 0.0
    found = np.full(matrices.shape, np.inf)
    found[regular] = np.linalg.inv(matrices[regular])
    return found
