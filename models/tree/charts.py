"""Charts of a ball joint's rotation: they map three coordinates c to a quaternion and rates c' to an angular velocity G c'.

The quaternion is relative to the reference orientation. The angular velocity is in the child's frame, like MuJoCo's qvel.

`StereographicChart`: c = 4 tan(theta / 4) axis, four times the modified Rodrigues parameters sigma (Schaub & Junkins,
Analytical Mechanics of Space Systems, 3.5). For small angles c is the rotation vector; c is singular only at a full turn.

    quaternion = (1 - |sigma|^2, 2 sigma) / (1 + |sigma|^2),
    G = [(1 - |sigma|^2) I - 2 [sigma x] + 2 sigma sigma^T] / (1 + |sigma|^2)^2

`RodChart` describes a rod whose ball joint sits on a body that turns about a hinge. The rod follows each turn of the hinge
and may spin about its own line. The coordinates are the angles of a universal joint and a spin: R = R(a, alpha) R(b, beta)
R(c, sigma) with a along the hinge, c along the rod, b normal to both, and c = (sigma, beta, alpha). Azimuth alpha and spin
sigma are unlimited. The chart is singular where the rod lies along the hinge's axis. With theta the angle between hinge and
rod, in the axes b x c, b, c:

    G = [[0, sin sigma, -sin theta cos sigma], [0, cos sigma, sin theta sin sigma], [1, 0, cos theta]]
"""

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

# Largest value [rad] of each coordinate of a stereographic chart. It allows a turn of 218 deg about one axis, and 270 deg
# where all three coordinates are at their limits. The singularity is at 360 deg.
CHART_RANGE = 5.56
# Least angle [rad] between a rod's line and the hinge's axis. The azimuth turns up to 19 times as fast as the rod there.
_LEAST_POLE_ANGLE = 0.0525


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class StereographicChart:
    """The chart of any ball joint. The columns of `axes` (3, 3) are the coordinates' axes in the child's frame."""

    axes: np.ndarray

    limits = np.array([[-CHART_RANGE, CHART_RANGE]] * 3)
    periodic = np.zeros(3, dtype=bool)  # true for a coordinate that repeats after a whole turn
    end = "218 deg about one axis from its reference orientation"

    def quaternion_of(self, c: np.ndarray) -> np.ndarray:
        """Return the quaternions (..., 4) of coordinates (..., 3)."""
        sigma = np.asarray(c, dtype=float) @ self.axes.T / 4
        square = np.sum(sigma**2, axis=-1, keepdims=True)
        return np.concatenate([1 - square, 2 * sigma], axis=-1) / (1 + square)

    def coordinates_of(self, quaternion: np.ndarray) -> np.ndarray:
        """Return the coordinates (..., 3) of quaternions (..., 4) without changing their sign; infinite at a full turn."""
        with np.errstate(divide="ignore", invalid="ignore"):  # the chart is singular at a full turn
            return 4 * (quaternion[..., 1:] @ self.axes) / (1 + quaternion[..., :1])

    def velocity_of(self, c: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return the angular velocity (..., 3) of rates c'."""
        square = np.sum((np.asarray(c) @ self.axes.T / 4) ** 2, axis=-1, keepdims=True)
        along = rates @ self.axes.T
        return np.einsum("...ji,...j->...i", self._inverse(c), along) / (1 + square) ** 2

    def rates_of(self, c: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Return the rates c' (..., 3) of an angular velocity."""
        return np.einsum("...ij,...j->...i", self._inverse(c), velocity) @ self.axes

    def _inverse(self, c: np.ndarray) -> np.ndarray:
        """Return the matrix (..., 3, 3) from w to 4 sigma': (1 - |sigma|^2) I + 2 [sigma x] + 2 sigma sigma^T."""
        sigma = np.asarray(c) @ self.axes.T / 4
        square = np.sum(sigma**2, axis=-1)[..., None, None]
        cross = np.cross(np.eye(3), sigma[..., None, :])  # [sigma x]: row i is e_i x sigma
        return (1 - square) * np.eye(3) + 2 * cross + 2 * sigma[..., :, None] * sigma[..., None, :]

    def quaternion(self, c: ca.SX) -> ca.SX:
        """Return the quaternion (4,) as an expression."""
        sigma = ca.DM(self.axes) @ c / 4
        square = ca.dot(sigma, sigma)
        return ca.vertcat(1 - square, 2 * sigma) / (1 + square)

    def velocity_matrix(self, c: ca.SX) -> ca.SX:
        """Return G (3, 3) as an expression."""
        sigma = ca.DM(self.axes) @ c / 4
        square = ca.dot(sigma, sigma)
        G = ((1 - square) * ca.SX.eye(3) - 2 * ca.skew(sigma) + 2 * (sigma @ sigma.T)) / (1 + square) ** 2
        return G @ ca.DM(self.axes)


@dataclass(frozen=True, eq=False, kw_only=True)  # without slots: its constants are kept once computed
class RodChart:
    """The chart of a rod. `hinge` and `line` are the directions (3,) of hinge and rod in the child's frame at c = 0."""

    hinge: np.ndarray
    line: np.ndarray

    periodic = np.array([True, False, True])
    end = "3 deg from where the rod lies along the axis of the hinge that carries it"

    @property
    def limits(self) -> np.ndarray:
        """The lower and upper limits of the coordinates (3, 2) [rad]."""
        tilt = np.array([_LEAST_POLE_ANGLE, np.pi - _LEAST_POLE_ANGLE]) - self._home_angle
        return np.array([[-np.inf, np.inf], tilt, [-np.inf, np.inf]])

    @cached_property
    def _home_angle(self) -> float:
        """The angle [rad] between hinge and rod at c = 0."""
        return float(np.arctan2(np.linalg.norm(np.cross(self.hinge, self.line)), self.hinge @ self.line))

    @cached_property
    def _across(self) -> np.ndarray:
        across = np.cross(self.hinge, self.line)
        return across / np.linalg.norm(across)

    @cached_property
    def _frame(self) -> np.ndarray:
        """The axes (3, 3) of G: b x c, b, c."""
        return np.column_stack([np.cross(self._across, self.line), self._across, self.line])

    def quaternion_of(self, c: np.ndarray) -> np.ndarray:
        """Return the quaternions (..., 4) of coordinates (..., 3)."""
        c = np.asarray(c, dtype=float)
        sigma, theta, alpha = c[..., 0], c[..., 1] + self._home_angle, c[..., 2]
        cos, sin, total, difference = np.cos(theta / 2), np.sin(theta / 2), (alpha + sigma) / 2, (sigma - alpha) / 2
        along = np.stack([sin * np.sin(difference), sin * np.cos(difference), cos * np.sin(total)], axis=-1) @ self._euler.T
        whole = np.concatenate([(cos * np.cos(total))[..., None], along], axis=-1)
        return quaternion_product(whole, self._back)

    def coordinates_of(self, quaternion: np.ndarray) -> np.ndarray:
        """Return the coordinates (..., 3) of quaternions (..., 4), azimuth and spin within half a turn of zero."""
        whole = quaternion_product(quaternion, conjugate(self._back))
        w, (x, y, z) = whole[..., 0], np.moveaxis(whole[..., 1:] @ self._euler, -1, 0)
        total, difference = np.arctan2(z, w), np.arctan2(x, y)
        theta = 2 * np.arctan2(np.hypot(x, y), np.hypot(w, z))
        c = np.stack([total + difference, theta - self._home_angle, total - difference], axis=-1)
        c[..., [0, 2]] -= 2 * np.pi * np.round(c[..., [0, 2]] / (2 * np.pi))
        return c

    def velocity_of(self, c: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return the angular velocity (..., 3) of rates c'."""
        sin, cos, sin_tilt, cos_tilt = self._angles(c)
        spin, tilt, azimuth = np.moveaxis(np.asarray(rates, dtype=float), -1, 0)
        turn = sin_tilt * azimuth
        return (
            np.stack([tilt * sin - turn * cos, tilt * cos + turn * sin, spin + cos_tilt * azimuth], axis=-1) @ self._frame.T
        )

    def rates_of(self, c: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Return the rates c' (..., 3) of an angular velocity."""
        sin, cos, sin_tilt, cos_tilt = self._angles(c)
        first, second, along = np.moveaxis(np.asarray(velocity, dtype=float) @ self._frame, -1, 0)
        azimuth = (second * sin - first * cos) / sin_tilt
        return np.stack([along - cos_tilt * azimuth, first * sin + second * cos, azimuth], axis=-1)

    def quaternion(self, c: ca.SX) -> ca.SX:
        """Return the quaternion (4,) as an expression."""
        theta, total, difference = c[1] + self._home_angle, (c[2] + c[0]) / 2, (c[0] - c[2]) / 2
        cos, sin = ca.cos(theta / 2), ca.sin(theta / 2)
        along = ca.DM(self._euler) @ ca.vertcat(sin * ca.sin(difference), sin * ca.cos(difference), cos * ca.sin(total))
        w, back = cos * ca.cos(total), ca.DM(self._back)
        v = w * back[1:] + back[0] * along + ca.cross(along, back[1:])
        return ca.vertcat(w * back[0] - ca.dot(along, back[1:]), v)

    def velocity_matrix(self, c: ca.SX) -> ca.SX:
        """Return G (3, 3) as an expression."""
        sin, cos, sin_tilt, cos_tilt = (f(x) for x in (c[0], c[1] + self._home_angle) for f in (ca.sin, ca.cos))
        rows = [ca.horzcat(0, sin, -sin_tilt * cos), ca.horzcat(0, cos, sin_tilt * sin), ca.horzcat(1, 0, cos_tilt)]
        return ca.DM(self._frame) @ ca.sparsify(ca.vertcat(*rows))

    def _angles(self, c: np.ndarray):
        sigma, theta = np.asarray(c)[..., 0], np.asarray(c)[..., 1] + self._home_angle
        return np.sin(sigma), np.cos(sigma), np.sin(theta), np.cos(theta)

    @cached_property
    def _euler(self) -> np.ndarray:
        """The axes (3, 3) b x a, b, a. In them the rotation, apart from `_back`, has Euler angles z, y, z."""
        return np.column_stack([np.cross(self._across, self.hinge), self._across, self.hinge])

    @cached_property
    def _back(self) -> np.ndarray:
        """The quaternion (4,) that turns the rod's line back to the hinge's axis."""
        return np.concatenate([[np.cos(self._home_angle / 2)], -np.sin(self._home_angle / 2) * self._across])


def quaternion_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the Hamilton product of quaternions (..., 4), w first."""
    a, b = np.broadcast_arrays(a, b)
    w = a[..., :1] * b[..., :1] - np.sum(a[..., 1:] * b[..., 1:], axis=-1, keepdims=True)
    (_, i, j, k), (_, x, y, z) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    across = np.stack([j * z - k * y, k * x - i * z, i * y - j * x], axis=-1)  # four times as fast as np.cross
    return np.concatenate([w, a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + across], axis=-1)


def conjugate(quaternion: np.ndarray) -> np.ndarray:
    """Return the conjugates of quaternions (..., 4)."""
    return quaternion * np.array([1.0, -1.0, -1.0, -1.0])
