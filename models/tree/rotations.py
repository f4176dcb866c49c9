"""Rotation matrices and quaternions, as numbers and as expressions."""

import casadi as ca
import numpy as np


def rotation_from_quaternion(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a unit quaternion (w, x, y, z). Exact zeros stay exact."""
    w, x, y, z = np.asarray(quaternion) / np.linalg.norm(quaternion)
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


def product(a: ca.SX, b: ca.SX) -> ca.SX:
    """Return the Hamilton product of two quaternions (4,)."""
    v = a[0] * b[1:] + b[0] * a[1:] + ca.cross(a[1:], b[1:])
    return ca.vertcat(a[0] * b[0] - ca.dot(a[1:], b[1:]), v)


def rotation_of(quaternion: ca.SX) -> ca.SX:
    """Return the rotation matrix (3, 3) of a unit quaternion (4,), an expression."""
    w, v = quaternion[0], quaternion[1:]
    return ca.SX.eye(3) + 2 * w * ca.skew(v) + 2 * ca.skew(v) @ ca.skew(v)


def rotation_about(axis: np.ndarray, angle: ca.SX) -> ca.SX:
    """Return the rotation matrix (3, 3) about an axis (Rodrigues). A coordinate axis gives exact zeros and ones."""
    a = np.asarray(axis) / np.linalg.norm(axis)
    along = np.outer(a, a)
    cross = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    return ca.DM(along) + ca.cos(angle) * ca.DM(np.eye(3) - along) + ca.sin(angle) * ca.DM(cross)
