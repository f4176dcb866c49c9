"""The internal coordinates q of a mechanism: one for every degree of freedom of the tree, beside MuJoCo's qpos and qvel.

A hinge or slide is its own coordinate, MuJoCo's qpos. A ball joint has three, a chart of the rotation group centred at the
reference orientation: c = 4 tan(theta / 4) axis, four times the modified Rodrigues parameters sigma (Schaub & Junkins,
Analytical Mechanics of Space Systems, 3.5): for small angles the rotation vector, and singular at a full turn only.


    quaternion = centre * (1 - |sigma|^2, 2 sigma) / (1 + |sigma|^2),
    w = G c',   G = [(1 - |sigma|^2) I - 2 [sigma x] + 2 sigma sigma^T] / (1 + |sigma|^2)^2,

w the angular velocity in the child's frame, as MuJoCo's qvel has it. The axes of c are the child's, but for a rod between
two balls, whose first is the rod's line: its spin is then a coordinate of its own. A free joint is three slides along the
world's axes and such a chart. So n_q = n_v, and velocities are rates of coordinates: qvel = T(q) q', T the identity but for
the blocks G.
"""

from dataclasses import dataclass

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.tree.ties import rod_line

HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
BALL = int(mujoco.mjtJoint.mjJNT_BALL)
FREE = int(mujoco.mjtJoint.mjJNT_FREE)

# A chart's coordinates stay within this [rad], each: about one axis that is a turn of 218 deg to either side, and where all
# three are at their ends, 270 deg, three quarters of the way to the singularity at a full turn.
CHART_RANGE = 5.56


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Chart:
    """The three rotation coordinates of a ball or free joint: MuJoCo's joint, their first, the quaternion's place."""

    name: str
    joint: int
    first: int  # of the coordinates, and of the three angular velocities in qvel
    quaternion: int  # address in qpos
    centre: np.ndarray  # (4,) the unit quaternion at c = 0
    axes: np.ndarray  # (3, 3) whose columns are the coordinates' axes in the child's frame


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Coordinates:
    """Conversions between internal coordinates and MuJoCo's; every array may carry samples in front."""

    n_qpos: int
    scalars: np.ndarray  # (n_scalars, 2) coordinate and its place in qpos
    charts: tuple[Chart, ...]

    @property
    def trivial(self) -> bool:
        """Whether q is qpos and q' is qvel."""
        return not self.charts

    def qpos_of(self, q: np.ndarray) -> np.ndarray:
        """Return MuJoCo's qpos (..., nq) of coordinates q (..., n_q)."""
        q = np.asarray(q, dtype=float)
        qpos = np.zeros((*q.shape[:-1], self.n_qpos))
        qpos[..., self.scalars[:, 1]] = q[..., self.scalars[:, 0]]
        for chart in self.charts:
            sigma = _along_axes(chart, q) / 4
            square = np.sum(sigma**2, axis=-1, keepdims=True)
            turned = np.concatenate([1 - square, 2 * sigma], axis=-1) / (1 + square)
            qpos[..., chart.quaternion : chart.quaternion + 4] = quaternion_product(chart.centre, turned)
        return qpos

    def q_of(self, qpos: np.ndarray) -> np.ndarray:
        """Return coordinates q (..., n_q) of MuJoCo's qpos (..., nq).

        The quaternion's sign is kept: along a simulation it is continuous, and so are the coordinates up to a full turn.
        """
        qpos = np.asarray(qpos, dtype=float)
        q = np.zeros((*qpos.shape[:-1], len(self.scalars) + 3 * len(self.charts)))
        q[..., self.scalars[:, 0]] = qpos[..., self.scalars[:, 1]]
        for chart in self.charts:
            turned = quaternion_product(_conjugate(chart.centre), qpos[..., chart.quaternion : chart.quaternion + 4])
            turned = turned / np.linalg.norm(turned, axis=-1, keepdims=True)
            with np.errstate(divide="ignore", invalid="ignore"):  # a full turn is beyond the chart: infinite, not an error
                q[..., chart.first : chart.first + 3] = 4 * (turned[..., 1:] @ chart.axes) / (1 + turned[..., :1])
        return q

    def qvel_of(self, q: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return MuJoCo's qvel (..., nv) of coordinates and their rates (..., n_q)."""
        qvel = np.array(rates, dtype=float)
        for chart in self.charts:
            at = slice(chart.first, chart.first + 3)
            turned = _along_axes(chart, q)
            square = np.sum((turned / 4) ** 2, axis=-1, keepdims=True)
            along = qvel[..., at] @ chart.axes.T
            qvel[..., at] = np.einsum("...ji,...j->...i", _rates_of_velocity(turned), along) / (1 + square) ** 2
        return qvel

    def rates_of(self, q: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Return the rates q' (..., n_q) of coordinates q under MuJoCo's qvel (..., nv)."""
        rates = np.array(qvel, dtype=float)
        for chart in self.charts:
            at = slice(chart.first, chart.first + 3)
            matrix = _rates_of_velocity(_along_axes(chart, q))
            rates[..., at] = np.einsum("...ij,...j->...i", matrix, rates[..., at]) @ chart.axes
        return rates

    def velocity_matrix(self, q: ca.SX) -> ca.SX:
        """Return T (n_q, n_q) with qvel = T q', sparse."""
        matrix = ca.SX.eye(q.numel())
        for chart in self.charts:
            at = slice(chart.first, chart.first + 3)
            sigma = ca.DM(chart.axes) @ q[at] / 4
            square = ca.dot(sigma, sigma)
            G = ((1 - square) * ca.SX.eye(3) - 2 * ca.skew(sigma) + 2 * (sigma @ sigma.T)) / (1 + square) ** 2
            matrix[at, at] = G @ ca.DM(chart.axes)
        return matrix

    def left(self, q: np.ndarray) -> str | None:
        """Return the name of a joint whose chart the poses q (..., n_q) leave, or None."""
        for chart in self.charts:
            if not np.all(np.abs(np.asarray(q)[..., chart.first : chart.first + 3]) <= CHART_RANGE * (1 + 1e-9)):
                return chart.name
        return None


def turned_quaternion(chart: Chart, q: ca.SX) -> ca.SX:
    """Return the quaternion (4,) of a chart at coordinates q (n_q,), relative to its centre."""
    sigma = ca.DM(chart.axes) @ q[chart.first : chart.first + 3] / 4
    square = ca.dot(sigma, sigma)
    return ca.vertcat(1 - square, 2 * sigma) / (1 + square)


def read_coordinates(model: mujoco.MjModel, reference: np.ndarray) -> Coordinates:
    """Return a model's coordinates, charts centred at the orientations of `reference` (nq,), a qpos."""
    scalars, charts = [], []
    for joint in range(model.njnt):
        kind, dof, address = int(model.jnt_type[joint]), int(model.jnt_dofadr[joint]), int(model.jnt_qposadr[joint])
        if kind in (HINGE, SLIDE):
            scalars.append((dof, address))
            continue
        if kind == FREE:
            scalars += [(dof + k, address + k) for k in range(3)]
            dof, address = dof + 3, address + 3
        centre = np.array(reference[address : address + 4], dtype=float)
        charts.append(
            Chart(
                name=joint_label(model, joint),
                joint=joint,
                first=dof,
                quaternion=address,
                centre=centre / np.linalg.norm(centre),
                axes=_axes(model, joint),
            )
        )
    return Coordinates(n_qpos=model.nq, scalars=np.array(scalars, dtype=int).reshape(-1, 2), charts=tuple(charts))


def _axes(model: mujoco.MjModel, joint: int) -> np.ndarray:
    """Return the axes of a chart (3, 3): the child's own, turned the shortest way so that the first is a rod's line."""
    line = rod_line(model, joint) if int(model.jnt_type[joint]) == BALL else None
    if line is None:
        return np.eye(3)
    line = line if line[0] >= 0 else -line
    v = np.cross([1.0, 0.0, 0.0], line)
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + cross + cross @ cross / (1 + line[0])


def _along_axes(chart: Chart, q: np.ndarray) -> np.ndarray:
    """Return a chart's coordinates (..., 3) along the child's axes."""
    return np.asarray(q, dtype=float)[..., chart.first : chart.first + 3] @ chart.axes.T


def joint_label(model: mujoco.MjModel, joint: int) -> str:
    """Return a joint's name, or one made of its index."""
    return model.joint(joint).name or f"joint{joint}"


def quaternion_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the Hamilton product of quaternions (..., 4), w first."""
    a, b = np.broadcast_arrays(a, b)
    w = a[..., :1] * b[..., :1] - np.sum(a[..., 1:] * b[..., 1:], axis=-1, keepdims=True)
    v = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + np.cross(a[..., 1:], b[..., 1:])
    return np.concatenate([w, v], axis=-1)


def _conjugate(quaternion: np.ndarray) -> np.ndarray:
    return quaternion * np.array([1.0, -1.0, -1.0, -1.0])


def _rates_of_velocity(c: np.ndarray) -> np.ndarray:
    """Return G^-1 (..., 3, 3), c' = G^-1 w: (1 - |sigma|^2) I + 2 [sigma x] + 2 sigma sigma^T."""
    sigma = c / 4
    square = np.sum(sigma**2, axis=-1)[..., None, None]
    cross = np.cross(np.eye(3), sigma[..., None, :])  # [sigma x]: row i is e_i x sigma
    return (1 - square) * np.eye(3) + 2 * cross + 2 * sigma[..., :, None] * sigma[..., None, :]
