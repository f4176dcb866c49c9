"""Closed pose and rates of a plant that differs from its mechanism, by Newton's method on MuJoCo's constraint residuals."""

import mujoco
import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism

# Newton's method stops below this residual [m or rad], which is rounding for poses of about a metre.
_ROUNDING_RESIDUAL = 1e-13
# Largest accepted residual [m or rad], far below the gap of a soft loop.
_MAX_RESIDUAL = 1e-9


def closed_pose(model: mujoco.MjModel, data: mujoco.MjData, mechanism: Mechanism, pose: np.ndarray) -> np.ndarray:
    """Return the closed pose (n_q,) near a pose with the same independent coordinates; `data` is overwritten.

    Raises:
        AssemblyError: if the loop does not close there.
    """
    dependent = mechanism.dependent
    q, best, residual = np.array(pose, dtype=float), np.array(pose, dtype=float), np.inf
    for _ in range(50):
        r, J = _equalities(model, data, mechanism, q)
        size = float(np.abs(r).max(initial=0.0))
        if not size < residual:
            break
        best, residual = q.copy(), size
        if size < _ROUNDING_RESIDUAL:
            break
        q[dependent] -= np.linalg.lstsq(J[:, dependent], r, rcond=None)[0]
    if residual > _MAX_RESIDUAL:
        joints = zip(mechanism.independent_joints, q[mechanism.independent], strict=True)
        where = ", ".join(f"{joint.name} = {joint.said(x, 4)} {joint.unit}" for joint, x in joints)
        raise AssemblyError(
            f"the loop does not close at the start, {where}, with this machine's lengths: {1e3 * residual:.3g} mm are left"
        )
    return best


def closed_rates(
    model: mujoco.MjModel, data: mujoco.MjData, mechanism: Mechanism, pose: np.ndarray, rates: np.ndarray
) -> np.ndarray:
    """Return rates (n_q,) with dependent rates that keep the loop closed, J q' = 0; `data` is overwritten."""
    _, J = _equalities(model, data, mechanism, pose)
    found, dependent = np.array(rates, dtype=float), mechanism.dependent
    found[dependent] = 0.0
    found[dependent] = -np.linalg.lstsq(J[:, dependent], J @ found, rcond=None)[0]
    return found


def _equalities(
    model: mujoco.MjModel, data: mujoco.MjData, mechanism: Mechanism, q: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the equality constraints' residual (n_r,) and Jacobian (n_r, n_q) at a pose (n_q,)."""
    data.qpos[:] = mechanism.qpos_of(q)
    mujoco.mj_fwdPosition(model, data)
    rows = data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    J = np.zeros((len(rows), model.nv))
    if mujoco.mj_isSparse(model):
        for row, begin, count in zip(J, data.efc_J_rowadr, data.efc_J_rownnz, strict=True):
            row[data.efc_J_colind[begin : begin + count]] = data.efc_J[begin : begin + count]
    else:
        J[:] = data.efc_J.reshape(J.shape)
    J = J[rows]
    if not mechanism.coordinates.trivial:
        J = J @ mechanism.qvel_of(np.tile(q, (model.nv, 1)), np.eye(model.nv)).T
    return data.efc_pos[rows].copy(), J
