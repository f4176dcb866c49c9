"""The forces that a serial equivalent omits: as a table over the output joints' positions, and as errors along a motion."""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.models.poses.along import sampled
from linkplan.models.poses.assembly import follow
from linkplan.models.transfer.grid import Grid, interpolated
from linkplan.models.transfer.output_map import OutputMap, transmission
from linkplan.models.transfer.serial import SerialModel
from linkplan.models.tree.joints import unit_steps


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class OutputMotion:
    """A motion of the output joints: times (n,) [s], positions, velocities and accelerations (n, n_o) [rad or m]."""

    time_s: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SerialErrors:
    """Errors of models without loops along a motion: the required effort (n, n_o) minus the effort that they compute.

    `effort` is what the closed chain needs. `static_map` is the error of the tree without anything reflected, whose efforts
    are carried across by G alone; `serial` that of the serial equivalent; `with_table` that of both together with the rest.
    """

    motion: OutputMotion
    effort: np.ndarray
    static_map: np.ndarray
    serial: np.ndarray
    with_table: np.ndarray

    def named(self) -> Mapping[str, np.ndarray]:
        """Return the errors by the names of the models."""
        return {"static map": self.static_map, "serial equivalent": self.serial, "serial with table": self.with_table}

    def rms(self) -> Mapping[str, np.ndarray]:
        """Return the rms of each error over time (n_o,), by the names of the models."""
        time = self.motion.time_s
        return {
            name: np.sqrt(np.trapezoid(off**2, time, axis=0) / (time[-1] - time[0])) for name, off in self.named().items()
        }


def rest_values(outputs: OutputMap, serial: SerialModel, grid: Grid) -> dict[str, np.ndarray]:
    """Return the rest at the nodes of a grid of outputs, (shape of the grid, ...): what the serial model lacks.

    "inertia_rest" (n_o, n_o), "inertia_rest_slope" (n_o, n_o, n_o), its derivatives by the positions along the last axis,
    "damping_rest" (n_o, n_o), "effort_rest" (n_o,), the effort at rest, and, where the linkage has dry friction,
    "friction_rate" (n_f, n_o), the rates of the joints with friction divided by the outputs' rates. NaN off the map.
    """
    shape = tuple(len(axis) for axis in grid.axes)
    q = grid.values["pose"].reshape(len(grid.points), -1)
    tree_q = _tree_poses(serial, grid.points)
    closed, tree = transmission(outputs, q), transmission(serial.outputs, tree_q)
    values = {
        "inertia_rest": closed.inertia - tree.inertia,
        "inertia_rest_slope": _inertia_slope(outputs, q) - _inertia_slope(serial.outputs, tree_q),
        "damping_rest": closed.damping - tree.damping,
        "effort_rest": _effort(outputs, q) - _effort(serial.outputs, tree_q),
    }
    if serial.rubbing:
        rates = sampled(outputs.mechanism.dynamics.velocity_map, q)
        values["friction_rate"] = rates[:, list(serial.rubbing)][:, :, list(outputs.columns)]
    return {name: value.reshape(*shape, *value.shape[1:]) for name, value in values.items()}


def rest_effort(
    outputs: OutputMap, serial: SerialModel, values: Mapping[str, np.ndarray], grid: Grid, motion: OutputMotion
) -> np.ndarray:
    """Return the effort (n, n_o) of the rest along a motion, see `models.transfer.serial`, by interpolation.

    Dry friction is f tanh(v / v_0), as in `models.tree.friction`.
    """
    at = {name: interpolated(grid.axes, value, motion.position) for name, value in values.items()}
    v, slope = motion.velocity, at["inertia_rest_slope"]
    coriolis = np.einsum("nijk,nj,nk->ni", slope, v, v) - 0.5 * np.einsum("njki,nj,nk->ni", slope, v, v)
    total = np.einsum("nij,nj->ni", at["inertia_rest"], motion.acceleration) + coriolis
    total += np.einsum("nij,nj->ni", at["damping_rest"], v) + at["effort_rest"]
    if "friction_rate" in at:
        rates = at["friction_rate"]
        speed = np.einsum("nfo,no->nf", rates, v) / _transition(outputs, list(serial.rubbing))
        total += np.einsum("nfo,nf->no", rates, serial.rubbing_force * np.tanh(speed)) - _joint_friction(serial, v)
    return total


def _transition(outputs: OutputMap, joints: Sequence[int]) -> np.ndarray:
    """Return the transition speeds of dry friction (n,) [rad/s or m/s] of a mechanism's joints."""
    mechanism = outputs.mechanism
    return mechanism.friction_transition * unit_steps([mechanism.joints[i] for i in joints], mechanism.extent_m)


def _joint_friction(serial: SerialModel, v: np.ndarray) -> np.ndarray:
    """Return the dry friction (n, n_o) that the serial model's joints carry in place of the linkage."""
    tree = serial.outputs
    return serial.friction * np.tanh(v / _transition(tree, tree.coordinates.tolist()))


def serial_errors(
    outputs: OutputMap, serial: SerialModel, values: Mapping[str, np.ndarray], grid: Grid, motion: OutputMotion
) -> SerialErrors:
    """Return the errors of the static map, of the serial equivalent and of the latter with its table along a motion.

    Raises:
        AssemblyError: if the loops open on the way.
    """
    mechanism = outputs.mechanism
    q = follow(mechanism, outputs.independent(motion.position))
    needed = _effort(outputs, q, motion)
    tree = _effort(serial.outputs, _tree_poses(serial, motion.position), motion)
    reflected = serial.armature * motion.acceleration + serial.damping * motion.velocity
    reflected += _joint_friction(serial, motion.velocity)
    rest = rest_effort(outputs, serial, values, grid, motion)
    return SerialErrors(
        motion=motion,
        effort=needed,
        static_map=needed - (tree - reflected),
        serial=needed - tree,
        with_table=needed - tree - rest,
    )


def _tree_poses(serial: SerialModel, points: np.ndarray) -> np.ndarray:
    """Return the tree's poses (n, n_q) at output positions, its other joints at home."""
    q = np.tile(serial.mechanism.home, (len(points), 1))
    q[:, serial.mechanism.independent] = serial.outputs.independent(points)
    if len(serial.mechanism.dependent):
        return follow(serial.mechanism, q[:, serial.mechanism.independent])
    return q


def _effort(outputs: OutputMap, q: np.ndarray, motion: OutputMotion | None = None) -> np.ndarray:
    """Return the effort (n, n_o) that a motion of the outputs needs, by default rest; other coordinates are at rest."""
    v, a = np.zeros((2, len(q), outputs.mechanism.dof))
    if motion is not None:
        v[:, list(outputs.columns)], a[:, list(outputs.columns)] = motion.velocity, motion.acceleration
    return sampled(outputs.mechanism.dynamics.inverse_dynamics, q, v, a)[:, list(outputs.columns), 0]


@functools.lru_cache(maxsize=16)
def _slope_function(outputs: OutputMap) -> ca.Function:
    """Return the function q -> dM/ds of the outputs, flattened (n_o n_o, n_o)."""
    dynamics, columns = outputs.mechanism.dynamics, list(outputs.columns)
    q = ca.SX.sym("q", outputs.mechanism.n_q)
    inertia = dynamics.reduced_inertia(q)[columns, columns]
    slope = ca.jacobian(ca.vec(inertia), q) @ dynamics.velocity_map(q)[:, columns]
    return ca.Function("inertia_slope", [q], [ca.densify(slope)])


def _inertia_slope(outputs: OutputMap, q: np.ndarray) -> np.ndarray:
    n_o = len(outputs.columns)
    return sampled(_slope_function(outputs), q).reshape(len(q), n_o, n_o, n_o).transpose(0, 2, 1, 3)
