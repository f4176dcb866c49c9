"""The places of a model's bodies at a pose, by MuJoCo's kinematics, and bodies that stay at such a place."""

import mujoco
import numpy as np

# Kinds of joints, as numbers in a compiled model.
HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
BALL = int(mujoco.mjtJoint.mjJNT_BALL)
FREE = int(mujoco.mjtJoint.mjJNT_FREE)


def data_at(model: mujoco.MjModel, qpos: np.ndarray | None = None) -> mujoco.MjData:
    """Return MuJoCo's data with the kinematics at a qpos (nq,), by default at the model's reference pose."""
    data = mujoco.MjData(model)
    if qpos is not None:
        data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return data


def fields_at(model: mujoco.MjModel, qpos: np.ndarray, *fields: str) -> list[np.ndarray]:
    """Return fields of MuJoCo's kinematics, such as "xanchor" (njnt, 3) [m], at qpos (n, nq), each (n, ...)."""
    data = mujoco.MjData(model)
    found = [np.empty((len(qpos), *getattr(data, field).shape)) for field in fields]
    for k, pose in enumerate(qpos):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        for array, field in zip(found, fields, strict=True):
            array[k] = getattr(data, field)
    return found


def in_world(data: mujoco.MjData, body: int, place: np.ndarray) -> np.ndarray:
    """Return the world position (3,) [m] of a point in a body's frame."""
    return data.xpos[body] + data.xmat[body].reshape(3, 3) @ place


def in_body(data: mujoco.MjData, body: int, place: np.ndarray) -> np.ndarray:
    """Return the position (3,) [m] in a body's frame of a point in the world."""
    return data.xmat[body].reshape(3, 3).T @ (place - data.xpos[body])


def fix_in_parent(part: "mujoco._specs.MjsBody", model: mujoco.MjModel, data: mujoco.MjData, body: int) -> None:
    """Set the pose in its parent of a specification's body, which is `body` of the model, to that of `data`."""
    parent = int(model.body_parentid[body])
    inverse, turn = np.zeros(4), np.zeros(4)
    mujoco.mju_negQuat(inverse, data.xquat[parent])
    mujoco.mju_mulQuat(turn, inverse, data.xquat[body])
    if part.frame is not None:
        part.set_frame(part.parent.add_frame())
    part.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    part.pos, part.quat = in_body(data, parent, data.xpos[body]), turn
