"""Actuators of the serial equivalent for training frameworks: a Python file for Isaac Lab and mjlab, and its look-up.

A framework has one number for each joint where a linkage has a curve. The numbers are those of the home pose; comments give
their range over the table. Both frameworks bound the effort by |u| <= effort_limit and by the line from saturation_effort at
rest to velocity_limit.
"""

import json

import numpy as np

from linkplan.models.transfer.polytope import effort_box, speed_box
from linkplan.studies.handover.transfer.study import Transfer, carried_gains

_HEAD = '''"""Actuators of {joints} of {mechanism} by linkplan transfer, for Isaac Lab and mjlab.

They hold at {pose}. `at` gives the quantities of table.npz at other poses, with NumPy alone: `at("effort_box", positions)`.
"""

from pathlib import Path

import numpy as np

ACTUATORS = {{
'''
_TAIL = '''}


def isaac_lab():
    """Return the actuators as DCMotorCfg by joint name, for ArticulationCfg(actuators=...)."""
    from isaaclab.actuators import DCMotorCfg

    return {name: DCMotorCfg(joint_names_expr=[name], **values) for name, values in ACTUATORS.items()}


def mjlab():
    """Return the actuators as DcMotorActuatorCfg, for EntityArticulationInfoCfg(actuators=...)."""
    from mjlab.actuator import DcMotorActuatorCfg

    def of(name, friction, **values):
        return DcMotorActuatorCfg(target_names_expr=(name,), frictionloss=friction, **values)

    return tuple(of(name, **values) for name, values in ACTUATORS.items())


_TABLE = dict(np.load(Path(__file__).with_name("table.npz"))) if Path(__file__).with_name("table.npz").exists() else {}


def at(quantity, positions):
    """Return a quantity of table.npz (n, ...) at joint positions (n, n_joints) [rad or m], linear between its nodes."""
    positions, found = np.asarray(positions, dtype=float), 0.0
    axes = [_TABLE[f"axis_{k}"] for k in range(positions.shape[1])]
    low = [np.clip(np.searchsorted(a, x, side="right") - 1, 0, len(a) - 2) for a, x in zip(axes, positions.T)]
    share = [(x - a[i]) / (a[i + 1] - a[i]) for a, x, i in zip(axes, positions.T, low)]
    for corner in np.ndindex(*[2] * len(axes)):
        weight = np.prod([s if c else 1.0 - s for s, c in zip(share, corner)], axis=0)
        value = _TABLE[quantity][tuple(i + c for i, c in zip(low, corner))]
        found = found + weight.reshape(-1, *[1] * (value.ndim - 1)) * value
    return found
'''


def frameworks_text(transfer: Transfer) -> str:
    """Return the Python file of a transfer table's actuators."""
    outputs, grid, home = transfer.outputs, transfer.table.grid, transfer.home
    whole = grid.values["ratio"].reshape(-1, *home.ratio.shape[1:])
    known = np.isfinite(whole).all(axis=(1, 2))
    here, there = (_values(transfer, ratio) for ratio in (home.ratio, whole[known]))
    armature = grid.values["armature"].reshape(len(whole), *home.armature.shape[1:])[known]
    here |= {"armature": home.armature.diagonal(axis1=1, axis2=2), "friction": home.friction}
    there["armature"] = armature.diagonal(axis1=1, axis2=2)
    pose = ", ".join(f"{j.name} = {j.text(x, 4)} {j.unit}" for j, x in zip(outputs.joints, outputs.home, strict=True))
    lines = [_HEAD.format(joints=", ".join(j.name for j in outputs.joints), mechanism=outputs.mechanism.name, pose=pose)]
    for k, joint in enumerate(outputs.joints):
        lines.append(f"    {json.dumps(joint.name)}: {{\n")
        for name, values in here.items():
            ends = there.get(name)
            over = (
                ""
                if ends is None or not len(ends)
                else f"  # {ends[:, k].min():.4g} to {ends[:, k].max():.4g} over the table"
            )
            lines.append(f'        "{name}": {values[0, k]:.6g},{over}\n')
        lines += [] if "velocity_limit" in here else ["        # velocity_limit: unknown; motor_speed gives it\n"]
        lines.append("    },\n")
    return "".join([*lines, _TAIL])


def _values(transfer: Transfer, ratio: np.ndarray) -> dict[str, np.ndarray]:
    """Return the limits and gains (n, n_o) of the joints' actuators at ratios (n, n_m, n_o), without unknown ones."""
    box = effort_box(ratio, transfer.effort_limit)
    effort = np.maximum(0.0, np.minimum(-box[..., 0], box[..., 1]))
    found = {"effort_limit": effort, "saturation_effort": effort}
    if transfer.motor_stall is not None:
        stall = np.abs(ratio) * transfer.motor_stall[None, :, None]
        found["saturation_effort"] = np.maximum(stall.sum(axis=1), effort)
    if transfer.motor_speed is not None and ratio.shape[1] == ratio.shape[2]:
        found["velocity_limit"] = speed_box(ratio, transfer.motor_speed)
    gains = {name: values.diagonal(axis1=1, axis2=2) for name, values in carried_gains(transfer, ratio).items()}
    for key, letter in (("stiffness", "kp"), ("damping", "kd")):
        given = transfer.gains.get(f"joint_{letter}")
        own = None if given is None else np.broadcast_to(given, (len(ratio), ratio.shape[2]))
        found[key] = gains.get(f"joint_{letter}", np.zeros((len(ratio), ratio.shape[2]))) if own is None else own
    return found
