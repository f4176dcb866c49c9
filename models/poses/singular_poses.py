"""Singular poses told apart: dead centres of the coordinate that leads, and poses at which the mechanism itself branches.

J_z loses rank at both. Where J over all rows and joints keeps its rank, the loops still fix the same number of motions: the
coordinate is at a dead centre, and another one leads through it. Where J loses rank too, motions that were forbidden become
possible to first order, and the mechanism may go over to another branch or gain a freedom. Least singular values
show either, also where det J_z touches zero without a change of sign, two loops folding at once.
"""

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled

# A least singular value below this share of home's is zero at a pose found to 1e-8.
_RANK_LOST = 1e-4
# Samples between which a least singular value dips below this share of home's are looked at closely.
_DIP = 0.3
# Directions of a plane that are looked at, half a degree apart; how far [rad] J is followed along one; and the share of the
# largest bend below which a direction goes straight on: at a simple zero a degree away from it, a double one's wider.
_DIRECTIONS, _BEND, _STRAIGHT = 360, 1e-5, 0.02


def least_values(mechanism: Mechanism, q: np.ndarray) -> np.ndarray:
    """Return the least singular values (2,) of J and of J_z that the closure's rank at home counts, slides by the extent."""
    return least_values_along(mechanism, np.asarray(q)[None])[0]


def least_values_along(mechanism: Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return the same (n, 2) at poses (n, n_q)."""
    rank = len(mechanism.dependent)
    if rank == 0:
        return np.ones((len(poses), 2))
    unit = np.array([1.0 if joint.kind == "hinge" else mechanism.extent_m for joint in mechanism.joints])
    jacobian = sampled(mechanism.dynamics.closure_jacobian, poses) * unit
    both = (np.linalg.svd(A, compute_uv=False) for A in (jacobian, jacobian[:, :, mechanism.dependent]))
    return np.stack([values[:, rank - 1] for values in both], axis=1)


def is_branching(mechanism: Mechanism, q: np.ndarray) -> bool:
    """Return whether the closure itself loses rank at a singular pose (n_q,), or the coordinate is at a dead centre only."""
    at_home = least_values(mechanism, mechanism.home)[0]
    return bool(least_values(mechanism, q)[0] < _RANK_LOST * at_home)


def closure_rank(mechanism: Mechanism, q: np.ndarray) -> int:
    """Return the rank of the closure at a pose (n_q,), counted against the least singular value at home."""
    unit = np.array([1.0 if joint.kind == "hinge" else mechanism.extent_m for joint in mechanism.joints])
    values = np.linalg.svd(np.array(mechanism.dynamics.closure_jacobian(q)) * unit, compute_uv=False)
    return int(np.sum(values[: len(mechanism.dependent)] > _RANK_LOST * least_values(mechanism, mechanism.home)[0]))


def dips(mechanism: Mechanism, poses: np.ndarray) -> list[int]:
    """Return the samples k of poses (n, n_q), ends left out, at which the least singular value of J_z dips."""
    if len(mechanism.dependent) == 0 or len(poses) < 3:
        return []
    values = least_values_along(mechanism, poses)[:, 1]
    at_home = least_values(mechanism, mechanism.home)[1]
    inner = values[1:-1]
    lowest = (inner <= values[:-2]) & (inner <= values[2:]) & (inner < _DIP * at_home)
    return [int(k) + 1 for k in np.flatnonzero(lowest)]


def all_regular(mechanism: Mechanism, poses: np.ndarray) -> bool:
    """Return whether no least singular value of J_z at poses (n, n_q) is so low that it wants a closer look."""
    at_home = least_values(mechanism, mechanism.home)[1]
    return bool(np.all(least_values_along(mechanism, poses)[:, 1] >= _DIP * at_home))


def vanishes(mechanism: Mechanism, q: np.ndarray) -> bool:
    """Return whether J_z has lost rank at a pose (n_q,)."""
    return bool(least_values(mechanism, q)[1] < _RANK_LOST * least_values(mechanism, mechanism.home)[1])


def has_one_way_on(mechanism: Mechanism, q: np.ndarray) -> bool:
    """Return whether only one motion leads through a pose (n_q,) at which the closure has lost one rank: no branch there.

    Rates x in the kernel of J go on where J x' + (dJ x) x = 0 has a solution x': where u^T (dJ x) x vanishes for all u with
    u^T J = 0 (second-order analysis; Wohlhart, Degrees of shakiness, 1999). In a kernel of two dimensions that is looked at
    in every direction; larger ones are left undecided, and so is what vanishes altogether.
    """
    unit = np.array([1.0 if joint.kind == "hinge" else mechanism.extent_m for joint in mechanism.joints])
    rank = closure_rank(mechanism, q)
    if mechanism.n_q - rank != 2:
        return False

    def scaled(pose: np.ndarray) -> np.ndarray:
        return np.array(mechanism.dynamics.closure_jacobian(pose)) * unit

    left, _, right = np.linalg.svd(scaled(q))
    apart, kernel = left[:, rank:].T, right[rank:]
    angles = np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS
    bent = []
    for x in np.column_stack([np.cos(angles), np.sin(angles)]) @ kernel:
        ahead, behind = (scaled(q + sign * _BEND * unit * x) for sign in (1, -1))
        bent.append(np.abs(apart @ (ahead - behind) @ x).max(initial=0.0) / (2 * _BEND))
    size = np.array(bent)
    small = size < _STRAIGHT * size.max()
    # Directions go round: the first follows the last.
    starts = small & ~np.roll(small, 1)
    return size.max() > _RANK_LOST and int(starts.sum()) == 1
