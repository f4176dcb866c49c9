"""Positions and axes of joints at given poses."""

from dataclasses import dataclass

import mujoco
import numpy as np

from linkplan.models.mechanism import Mechanism


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class JointFrames:
    """MuJoCo's joints at n poses in the world's frame: `anchors` and unit vectors `axes`, both (n, n_joints, 3) [m]."""

    anchors: np.ndarray
    axes: np.ndarray


def joint_frames(mechanism: Mechanism, poses: np.ndarray) -> JointFrames:
    """Return the joints' anchors and axes at poses q (n, n_q)."""
    model = mechanism.model
    data = mujoco.MjData(model)
    anchors, axes = (np.empty((len(poses), model.njnt, 3)) for _ in range(2))
    for k, qpos in enumerate(mechanism.qpos_of(poses)):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        anchors[k], axes[k] = data.xanchor, data.xaxis
    return JointFrames(anchors=anchors, axes=axes)
