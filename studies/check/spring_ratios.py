"""Lengths and motion ratios (d length / d coordinate) of springs between points along a path, by MuJoCo's tendons."""

import mujoco
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.tree.passive import is_gas_spring
from linkplan.models.tree.tendons import tendon_label


def sprung_tendons(model: mujoco.MjModel) -> dict[str, int]:
    """Return the tendons with a spring, a damper or a gas spring, by name."""
    springs = [
        model.tendon_stiffness[t] or model.tendon_damping[t] or np.any(model.tendon_stiffnesspoly[t])
        for t in range(model.ntendon)
    ]
    on_tendons = int(mujoco.mjtTrn.mjTRN_TENDON)
    gas = {
        int(model.actuator_trnid[a, 0])
        for a in range(model.nactuator)
        if int(model.actuator_trntype[a]) == on_tendons and is_gas_spring(model, a)
    }
    return {tendon_label(model, t): t for t in range(model.ntendon) if springs[t] or t in gas}


def spring_motion(mechanism: Mechanism, poses: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the lengths (n, n_t) [m] of the sprung tendons, and their motion ratios (n, n_t, n_s), per rad or m.

    Args:
        mechanism: of the path.
        poses: closed poses (n, n_q).
        rates: every joint's speed per speed of a coordinate (n, n_q, n_s).
    """
    model, tendons = mechanism.model, list(sprung_tendons(mechanism.model).values())
    length, ratio = np.zeros((len(poses), len(tendons))), np.zeros((len(poses), len(tendons), mechanism.dof))
    if not tendons:
        return length, ratio
    data, arms = mujoco.MjData(model), np.zeros((model.ntendon, model.nv))
    for k, q in enumerate(poses):
        data.qpos[:] = mechanism.qpos_of(q)
        mujoco.mj_fwdPosition(model, data)
        mujoco.mju_sparse2dense(arms, data.ten_J, model.ten_J_rownnz, model.ten_J_rowadr, model.ten_J_colind)
        speeds = np.array([mechanism.qvel_of(q, rates[k, :, c]) for c in range(mechanism.dof)])
        length[k], ratio[k] = data.ten_length[tendons], arms[tendons] @ speeds.T
    return length, ratio
