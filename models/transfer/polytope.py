"""Efforts, speeds and gains across a transmission l' = G v, tau = G^T u, at poses (n,)."""

import itertools

import numpy as np

from linkplan.models.actuation.distribution import unit_efforts

# Motors up to whose number the corners of the effort polytope are listed: 2^4 = 16 of them.
MOST_CORNER_MOTORS = 4


def effort_corners(ratio: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Return the joint efforts (n, 2^n_m, n_o) at the corners of the motors' effort limits (n_m, 2).

    Their convex hull is the polytope of joint efforts {G^T u}. With as many motors as joints every corner is a vertex. The
    order is that of binary counting: all motors at their lower limits first, the last motor changes first.
    """
    corners = np.array(list(itertools.product(*limit)))  # (2^n_m, n_m)
    return np.einsum("cm,nmo->nco", corners, ratio)


def effort_box(ratio: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Return the bounding box (n, n_o, 2) of the joint efforts {G^T u} for motor efforts within limits (n_m, 2)."""
    with np.errstate(invalid="ignore"):
        ends = np.where(ratio[..., None] == 0, 0.0, ratio[..., None] * limit[None, :, None, :])  # (n, n_m, n_o, 2)
    return np.stack([ends.min(axis=-1).sum(axis=1), ends.max(axis=-1).sum(axis=1)], axis=-1)


def speed_alone(ratio: np.ndarray, motor_speed: np.ndarray) -> np.ndarray:
    """Return each joint's largest speed (n, n_o) while the other joints rest, for motor speeds up to (n_m,)."""
    with np.errstate(divide="ignore"):
        return np.min(motor_speed[None, :, None] / np.abs(ratio), axis=1)


def speed_box(ratio: np.ndarray, motor_speed: np.ndarray) -> np.ndarray:
    """Return each joint's largest speed (n, n_o) if all joints may move at once; G is square."""
    return np.einsum("nom,m->no", np.abs(inverse_ratios(ratio)), motor_speed)


def motor_gains(ratio: np.ndarray, joint_gains: np.ndarray) -> np.ndarray:
    """Return the motors' gains K_m (n, n_m, n_m) that give the joints gains K_o (n_o, n_o): K_o = G^T K_m G.

    With more motors than joints they are the gains of least norm, with fewer the nearest. At rest without load the joints
    then have the stiffness K_o, whichever way the motors' errors are measured. NaN at a dead centre.
    """
    back = inverse_ratios(ratio)
    return np.einsum("nom,op,npk->nmk", back, joint_gains, back)


def joint_gains(ratio: np.ndarray, motor_gains: np.ndarray) -> np.ndarray:
    """Return the joints' gains G^T K_m G (n, n_o, n_o) for the motors' gains K_m (n_m, n_m)."""
    return np.einsum("nmo,mk,nkp->nop", ratio, motor_gains, ratio)


def inverse_ratios(ratio: np.ndarray) -> np.ndarray:
    """Return the pseudo-inverses (n, n_o, n_m) of G, NaN where G is singular or NaN."""
    found = np.full(ratio.transpose(0, 2, 1).shape, np.nan)
    known = np.isfinite(ratio).all(axis=(1, 2))
    values = np.linalg.svd(ratio[known], compute_uv=False)
    regular = np.flatnonzero(known)[values[:, -1] > 1e-12 * values[:, 0]]
    found[regular] = unit_efforts(ratio[regular])
    return found
