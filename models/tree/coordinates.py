"""The internal coordinates q of a mechanism, their conversion to MuJoCo's qpos and qvel, and rotation matrices.

A hinge or slide has one coordinate, its value in qpos. A ball joint has three coordinates, a chart of the rotation group
centred at the reference orientation (see `models.tree.charts`). They are four times the modified Rodrigues parameters along
the child's axes, or spin, tilt and azimuth for a rod on a turning hinge. A free joint has three slides along the world's
axes and three rotation coordinates. Hence n_q = n_v, and qvel = T(q) q', where T is the identity except for the charts'
blocks G.
"""

from dataclasses import dataclass

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.kinematics import BALL, FREE, HINGE, SLIDE, carrying_axis, rod_line, spin_line
from linkplan.models.symbolic_model import unit_of
from linkplan.models.tree.charts import RodChart, StereographicChart, conjugate, quaternion_product


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


def rotation_about(axis: np.ndarray | ca.SX, angle: ca.SX) -> ca.SX:
    """Return the rotation matrix (3, 3) about an axis (Rodrigues). A coordinate axis gives exact zeros and ones."""
    a = unit_of(axis)
    if isinstance(a, ca.SX):
        return ca.SX.eye(3) * ca.cos(angle) + (1 - ca.cos(angle)) * (a @ a.T) + ca.sin(angle) * ca.skew(a)
    along = np.outer(a, a)
    cross = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    return ca.DM(along) + ca.cos(angle) * ca.DM(np.eye(3) - along) + ca.sin(angle) * ca.DM(cross)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Chart:
    """The three rotation coordinates of a ball or free joint, with its index and addresses in MuJoCo's model."""

    name: str
    joint: int
    first: int  # index of the first coordinate in q and of the first angular velocity in qvel
    quaternion: int  # address in qpos
    centre: np.ndarray  # (4,) the unit quaternion at c = 0
    rotation: StereographicChart | RodChart

    @property
    def place(self) -> slice:
        """The slice of its coordinates in q and of the angular velocity in qvel."""
        return slice(self.first, self.first + 3)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Coordinates:
    """Conversions between internal coordinates and MuJoCo's. Every array may have leading sample axes."""

    n_qpos: int
    scalars: np.ndarray  # (n_scalars, 2) index in q and address in qpos
    charts: tuple[Chart, ...]

    @property
    def trivial(self) -> bool:
        """True if q is qpos and q' is qvel."""
        return not self.charts

    def chart_of(self, joint: int) -> Chart:
        """Return the chart of a ball or a free joint, by its index in the model."""
        return next(chart for chart in self.charts if chart.joint == joint)

    def qpos_of(self, q: np.ndarray) -> np.ndarray:
        """Return MuJoCo's qpos (..., nq) of coordinates q (..., n_q)."""
        q = np.asarray(q, dtype=float)
        qpos = np.zeros((*q.shape[:-1], self.n_qpos))
        qpos[..., self.scalars[:, 1]] = q[..., self.scalars[:, 0]]
        for chart in self.charts:
            turned = chart.rotation.quaternion_of(q[..., chart.place])
            qpos[..., chart.quaternion : chart.quaternion + 4] = quaternion_product(chart.centre, turned)
        return qpos

    def q_of(self, qpos: np.ndarray, near: np.ndarray | None = None) -> np.ndarray:
        """Return coordinates q (..., n_q) of MuJoCo's qpos (..., nq).

        The quaternion's sign is kept. The coordinates of a simulation are therefore continuous up to a full turn.
        Periodic coordinates are shifted by whole turns to the values nearest to `near` (..., n_q), by default to zero.
        """
        qpos = np.asarray(qpos, dtype=float)
        q = np.zeros((*qpos.shape[:-1], len(self.scalars) + 3 * len(self.charts)))
        q[..., self.scalars[:, 0]] = qpos[..., self.scalars[:, 1]]
        for chart in self.charts:
            turned = quaternion_product(conjugate(chart.centre), qpos[..., chart.quaternion : chart.quaternion + 4])
            turned = turned / np.linalg.norm(turned, axis=-1, keepdims=True)
            c = chart.rotation.coordinates_of(turned)
            if near is not None:
                turns = np.round((np.asarray(near)[..., chart.place] - c) / (2 * np.pi))
                c = c + 2 * np.pi * np.where(chart.rotation.periodic & np.isfinite(turns), turns, 0.0)
            q[..., chart.place] = c
        return q

    def qvel_of(self, q: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return MuJoCo's qvel (..., nv) of coordinates and their rates (..., n_q)."""
        qvel = np.array(rates, dtype=float)
        for chart in self.charts:
            qvel[..., chart.place] = chart.rotation.velocity_of(np.asarray(q)[..., chart.place], qvel[..., chart.place])
        return qvel

    def rates_of(self, q: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Return the rates q' (..., n_q) of coordinates q under MuJoCo's qvel (..., nv)."""
        rates = np.array(qvel, dtype=float)
        for chart in self.charts:
            rates[..., chart.place] = chart.rotation.rates_of(np.asarray(q)[..., chart.place], rates[..., chart.place])
        return rates

    def velocity_matrix(self, q: ca.SX) -> ca.SX:
        """Return T (n_q, n_q) with qvel = T q', sparse."""
        matrix = ca.SX.eye(q.numel())
        for chart in self.charts:
            matrix[chart.place, chart.place] = chart.rotation.velocity_matrix(q[chart.place])
        return matrix

    def range_violation(self, q: np.ndarray) -> str | None:
        """Return a description of the first chart whose range the poses q (..., n_q) leave, or None."""
        for chart in self.charts:
            low, high = chart.rotation.limits.T
            c = np.asarray(q)[..., chart.place]
            if not np.all((c >= low - 1e-9 * np.abs(low)) & (c <= high + 1e-9 * np.abs(high))):
                return f"ball joint '{chart.name}' further than its coordinates go ({chart.rotation.end})"
        return None


def turned_quaternion(chart: Chart, q: ca.SX) -> ca.SX:
    """Return the quaternion (4,) of a chart at coordinates q (n_q,), relative to its centre."""
    return chart.rotation.quaternion(q[chart.place])


def read_coordinates(model: mujoco.MjModel, reference: np.ndarray) -> Coordinates:
    """Return a model's coordinates, with charts centred at the orientations of `reference` (nq,), a qpos."""
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
                rotation=_rotation(model, joint, reference),
            )
        )
    return Coordinates(n_qpos=model.nq, scalars=np.array(scalars, dtype=int).reshape(-1, 2), charts=tuple(charts))


def _rotation(model: mujoco.MjModel, joint: int, reference: np.ndarray) -> StereographicChart | RodChart:
    """Return the chart of a joint's rotation: a `RodChart` for a rod on a hinge, else a `StereographicChart`.

    For a rod, the axes of the stereographic chart are the child's axes, rotated so that the first is the rod's line.
    """
    axis, spin = carrying_axis(model, joint, reference), spin_line(model, joint)
    # Closer than 30 deg (0.866 is the cosine) to the carrier's axis the motion may pass a rod chart's pole.
    if axis is not None and spin is not None and abs(float(axis @ spin)) < 0.866:
        return RodChart(hinge=axis, line=spin)
    line = rod_line(model, joint) if int(model.jnt_type[joint]) == BALL else None
    if line is None:
        return StereographicChart(axes=np.eye(3))
    line = line if line[0] >= 0 else -line
    v = np.cross([1.0, 0.0, 0.0], line)
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return StereographicChart(axes=np.eye(3) + cross + cross @ cross / (1 + line[0]))


def joint_label(model: mujoco.MjModel, joint: int) -> str:
    """Return a joint's name, or a name made from its index."""
    return model.joint(joint).name or f"joint{joint}"
