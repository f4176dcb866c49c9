"""The inertia that MuJoCo's own simulation, with its soft loops, lets a force on a coordinate accelerate."""

import mujoco
import numpy as np

from linkplan.models.mechanism import Mechanism


def felt_inertia(mechanism: Mechanism, pose: np.ndarray) -> np.ndarray:
    """Return the inertia (n_s,) [kg.m2 or kg] that a force on each independent coordinate accelerates in the simulation.

    All other coordinates are free, as between two control instants. Loops that are closed exactly leave 1 / (M^-1)_ii.
    Behind a soft loop, a drive at first moves little more than its own link, and feedback for the whole leg would be
    unstable. With the rows J and the regularisation R of MuJoCo's equality constraints, a force f accelerates by
    (M^-1 - M^-1 J^T (J M^-1 J^T + R)^-1 J M^-1) f (MuJoCo, "Computation", constraint model).
    """
    model = mechanism.model
    data = mujoco.MjData(model)
    data.qpos[:] = mechanism.qpos_of(pose)
    mujoco.mj_forward(model, data)
    rows, free = equality_rows(model, data)
    held = free @ rows.T @ np.linalg.solve(rows @ free @ rows.T + np.diag(data.efc_R[: data.ne]), rows @ free)
    found = np.empty(mechanism.dof)
    for column, index in enumerate(mechanism.independent.tolist()):
        unit = np.zeros(mechanism.n_q)
        unit[index] = 1.0
        found[column] = 1.0 / mechanism.rates_of(pose, (free - held) @ mechanism.qvel_of(pose, unit))[index]
    return found


def equality_rows(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows J (n, nv) of MuJoCo's equality constraints, and M^-1 (nv, nv), at the pose of a forward pass."""
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    return equality_jacobian(model, data), np.linalg.inv(mass)


def equality_jacobian(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return the rows J (n, nv) of MuJoCo's equality constraints at the pose of a forward pass."""
    rows = np.zeros((data.ne, model.nv))  # they stand before the rows of limits and contacts
    if mujoco.mj_isSparse(model):
        of_rows = (data.efc_J_rownnz[: data.ne], data.efc_J_rowadr[: data.ne])
        mujoco.mju_sparse2dense(rows, data.efc_J, *of_rows, data.efc_J_colind)
    else:
        rows[:] = data.efc_J[: rows.size].reshape(rows.shape)
    return rows
