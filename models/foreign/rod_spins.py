"""Rods on ball joints whose spin about their own line is locked: a universal joint takes the ball joint's place.

Nothing drives the spin of a rod between two ball joints, and it moves nothing else. The universal joint's first axis is that
of the hinge which carries the rod, normal to the rod at home, and its second is normal to both. Since the two axes are
always normal to each other, damping, armature and dry friction of the ball joint act on its two angles as before.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from linkplan.models.errors import ModelError, choose
from linkplan.models.kinematics import BALL, carrying_axis, rod_line

_COPIED = ("damping", "armature", "frictionloss", "solref_friction", "solimp_friction", "group", "userdata")


def spin_refusal(model: mujoco.MjModel, joint: int) -> str | None:
    """Return the reason why a joint's spin cannot be locked, or None if it can."""
    if int(model.jnt_type[joint]) != BALL:
        return "is not a ball joint"
    if rod_line(model, joint) is None:
        return "carries no rod: a rod's other ball joints and connects lie on one line through it, and nothing else holds it"
    if model.jnt_stiffness[joint] or model.jnt_limited[joint]:
        return "has a spring or a range, which a universal joint does not have"
    on_joint = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    if joint in model.actuator_trnid[np.isin(model.actuator_trntype, on_joint), 0]:
        return "is driven by an actuator"
    return None


def asked_spins(model: mujoco.MjModel, names: Sequence[str]) -> list[int]:
    """Return the ball joints whose spins are locked.

    Raises:
        ModelError: for an unknown name, or a joint whose spin cannot be locked.
    """
    joints = {model.joint(j).name: j for j in range(model.njnt)}
    for name in names:
        if reason := spin_refusal(model, joints[choose("joint in mechanism.lock_spin", name, joints)]):
            raise ModelError(f"mechanism.lock_spin: joint '{name}' {reason}")
    return [joints[name] for name in names]


def add_universal_joints(spec: mujoco.MjSpec, model: mujoco.MjModel, joints: Sequence[int], qpos: np.ndarray) -> None:
    """Add two hinges in place of each ball joint, which is locked at `qpos` (nq,) already; they are zero there."""
    for joint in joints:
        name, body = model.joint(joint).name, spec.body(model.body(int(model.jnt_bodyid[joint])).name)
        line, axis = rod_line(model, joint), carrying_axis(model, joint, qpos)
        assert line is not None  # `asked_spins` refuses a joint without a rod
        first = _normal_to(line, axis)
        former = spec.joint(name)
        for number, along in enumerate((first, np.cross(line, first)), 1):
            hinge = body.add_joint(name=f"{name}_{number}", type=mujoco.mjtJoint.mjJNT_HINGE, pos=former.pos, axis=along)
            for key in _COPIED:
                setattr(hinge, key, getattr(former, key))
            hinge.limited = mujoco.mjtLimited.mjLIMITED_FALSE  # a default class may limit all joints


def _normal_to(line: np.ndarray, axis: np.ndarray | None) -> np.ndarray:
    """Return the unit vector normal to a line that is nearest to an axis; any one if there is no axis or it is parallel."""
    for near in (axis, *np.eye(3)[np.argsort(np.abs(line))]):
        across = np.zeros(3) if near is None else near - (near @ line) * line
        if np.linalg.norm(across) > 0.1:
            return across / np.linalg.norm(across)
    raise AssertionError
