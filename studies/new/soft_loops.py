"""How far MuJoCo's soft loops open while the drives hold the weight."""

import mujoco
import numpy as np

from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.felt_inertia import equality_rows


def held_gap(mechanism: Mechanism) -> float:
    """Return the largest closure gap in MuJoCo while the drives hold the weight at home; 0 without loops or drives.

    It is a share of the mechanism's extent, or an angle [rad]. At rest the law a + R f = -K d r of a row (MuJoCo,
    "Constraint model") gives r = R f / (K d), with the forces f that keep the rows J q'' at zero.
    """
    if not mechanism.closures or not mechanism.n_u or not mechanism.dof:
        return 0.0
    model, still = mechanism.model, np.zeros((1, mechanism.dof))
    hold = needed_effort(mechanism, mechanism.home[None], still, still)[0][0]
    data = mujoco.MjData(model)
    data.qpos[:] = mechanism.qpos_of(mechanism.home)
    mujoco.mj_forward(model, data)
    rows, free = equality_rows(model, data)
    pushed = rows @ free @ (data.qfrc_passive - data.qfrc_bias + _joint_efforts(mechanism, hold))
    force = np.linalg.lstsq(rows @ free @ rows.T, -pushed, rcond=ROUNDING_SHARE)[0]
    stiffness, _, impedance, _ = data.efc_KBIP.reshape(-1, 4)[: data.ne].T
    gap = np.abs(data.efc_R[: data.ne] * force / (stiffness * impedance))
    return float(np.max(gap / np.where(_are_lengths(model, data), mechanism.extent_m, 1.0), initial=0.0))


def _joint_efforts(mechanism: Mechanism, effort: np.ndarray) -> np.ndarray:
    """Return the forces (nv,) on MuJoCo's degrees of freedom by the actuators' efforts (n_u,) at home."""
    on_joints = np.array(mechanism.dynamics.effort_matrix(mechanism.home)).reshape(mechanism.n_q, -1) @ effort
    units = np.array([mechanism.qvel_of(mechanism.home, unit) for unit in np.eye(mechanism.n_q)])
    return units.T @ on_joints


def _are_lengths(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return a mask of the equality rows whose gaps are lengths [m]: those of connects, and the first three of welds."""
    owner = np.array(data.efc_id[: data.ne])
    number = np.array([np.sum(owner[:k] == owner[k]) for k in range(data.ne)], dtype=int)
    kind = model.eq_type[owner]
    weld, connect = mujoco.mjtEq.mjEQ_WELD, mujoco.mjtEq.mjEQ_CONNECT
    return (kind == connect) | ((kind == weld) & (number < 3))
