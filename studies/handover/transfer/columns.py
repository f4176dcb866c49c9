"""A transfer table as columns with units in their names, and as arrays for NPZ."""

import json
from collections.abc import Iterator

import numpy as np

from linkplan.models.transfer.polytope import (
    MOST_CORNER_MOTORS,
    effort_box,
    effort_corners,
    speed_alone,
    speed_box,
)
from linkplan.models.tree.joints import inertia_unit_of
from linkplan.studies.handover.transfer.study import Transfer, carried_gains

# The meaning of each array of the NPZ file; joints are in the order of the table's axes, motors in the file's order.
MEANINGS = {
    "joint_position": "positions of the output joints",
    "motor_position": "motor positions: gear times joint position, as MuJoCo's actuator length",
    "ratio": "G: motor velocity = G joint velocity, joint effort = G^T motor effort",
    "ratio_slope": "dG/ds: G' = the sum over its last axis of dG/ds times joint velocity",
    "inertia": "reflected inertia of all that moves with the output joints",
    "armature": "the part of it that is armature of joints and rotors",
    "damping": "reflected viscous damping",
    "friction": "dry friction on each joint while it slides alone",
    "gravity": "effort that balances gravity",
    "hold": "effort at rest: gravity, springs and constant forces",
    "effort_box": "least and largest effort on each joint",
    "effort_corners": "joint efforts at the corners of the motors' limits, motors counted in binary, last one first",
    "speed_alone": "largest speed of each joint while the others rest",
    "speed_box": "largest speed of each joint in any motion",
    "motor_kp": "motor stiffness that gives the joints the requested stiffness",
    "motor_kd": "motor damping that gives the joints the requested damping",
    "joint_kp": "joint stiffness that the motors' stiffness gives",
    "joint_kd": "joint damping that the motors' damping gives",
    "inertia_rest": "inertia that the serial equivalent lacks",
    "inertia_rest_slope": "its derivatives by the joint positions, along the last axis",
    "damping_rest": "damping that the serial equivalent lacks",
    "friction_rate": "rates of the linkage's joints with dry friction, over those of the output joints",
    "effort_rest": "effort at rest (weight, springs and constant forces) that the serial equivalent lacks",
    "status": "0: on the map; 1: the loops do not close; 2: near a singular pose; 3: outside the map, for interpolation at"
    " the edge of the inverse map; 100 + k: joint k is beyond its range",
}


def arrays_of(transfer: Transfer) -> dict[str, np.ndarray]:
    """Return every quantity over the nodes (n, ...), in the order of `TransferTable.grid.points`."""
    table, limit = transfer.table, transfer.effort_limit
    points = table.grid.points
    flat = {
        name: value.reshape(len(points), *value.shape[len(table.grid.axes) :]) for name, value in table.grid.values.items()
    }
    found = {"joint_position": points, **{name: value for name, value in flat.items() if name not in ("pose", "status")}}
    ratio = flat["ratio"]
    found["effort_box"] = effort_box(ratio, limit)
    if ratio.shape[1] <= MOST_CORNER_MOTORS and np.isfinite(limit).all():
        found["effort_corners"] = effort_corners(ratio, limit)
    speed = transfer.motor_speed
    if speed is not None:
        found["speed_alone"] = speed_alone(ratio, speed)
        if ratio.shape[1] == ratio.shape[2]:
            found["speed_box"] = speed_box(ratio, speed)
    found |= carried_gains(transfer, ratio)
    if transfer.serial is not None:
        found |= {name: value.reshape(len(points), *value.shape[len(table.grid.axes) :])
                  for name, value in transfer.serial.rest.items()}  # fmt: skip
    return found | {"status": flat["status"]}


def columns_of(transfer: Transfer) -> dict[str, np.ndarray]:
    """Return the table as columns (n,); heads are like "inertia_pitch_roll [kg m2]"."""
    return {head: column for name, value in arrays_of(transfer).items() for head, column in _columns(transfer, name, value)}


def inverse_columns(transfer: Transfer) -> dict[str, np.ndarray] | None:
    """Return the inverse map, joint positions over motor positions, as columns; None without one."""
    inverse, outputs = transfer.table.inverse, transfer.outputs
    if inverse is None:
        return None
    motors = [
        (f"motor_position_{motor.name} [{motor.si_units[0]}]", x)
        for motor, x in zip(outputs.actuators, inverse.points.T, strict=True)
    ]
    joints = inverse.values["joint_position"].reshape(len(inverse.points), -1).T
    named = {
        f"joint_position_{joint.name} [{joint.si_units[0]}]": x for joint, x in zip(outputs.joints, joints, strict=True)
    }
    return dict(motors) | named | {"status [1]": inverse.values["status"].ravel()}


def npz_arrays(transfer: Transfer) -> dict[str, np.ndarray]:
    """Return the arrays of the NPZ file: axes, quantities in the shape of the grid, and `about`, JSON of names and units."""
    grid, outputs, inverse = transfer.table.grid, transfer.outputs, transfer.table.inverse
    shape = tuple(len(axis) for axis in grid.axes)
    values = arrays_of(transfer)
    arrays = {name: value.reshape(*shape, *value.shape[1:]) for name, value in values.items()}
    arrays |= {f"axis_{k}": axis for k, axis in enumerate(grid.axes)}
    if inverse is not None:
        arrays |= {f"inverse_axis_{k}": axis for k, axis in enumerate(inverse.axes)}
        arrays |= {f"inverse_{name}": value for name, value in inverse.values.items()}
    about = {
        "joints": [joint.name for joint in outputs.joints],
        "joint_units": [joint.si_units for joint in outputs.joints],
        "motors": [motor.name for motor in outputs.actuators],
        "motor_units": [motor.si_units for motor in outputs.actuators],
        "meaning": {name: MEANINGS[name] for name in values},
    }
    return arrays | {"about": np.array(json.dumps(about))}


def _columns(transfer: Transfer, name: str, value: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the heads and columns (n,) of a quantity (n, ...); for a symmetric one, of the upper triangle only."""
    outputs = transfer.outputs
    joints, motors = ([(one.name, *one.si_units) for one in of] for of in (outputs.joints, outputs.actuators))
    if name == "status":
        yield "status [1]", value
    elif name in ("effort_box", "effort_corners"):
        yield from _effort_columns(name, value, joints)
    else:
        rows = motors if name.startswith(("motor", "ratio")) else joints
        columns = motors if name.startswith("motor") else joints
        if name == "friction_rate":
            closed = outputs.mechanism.joints
            rows = [(closed[i].name, *closed[i].si_units) for i in transfer.serial.model.rubbing]
        stem, symmetric = _STEMS.get(name, name), name not in ("ratio", "ratio_slope", "friction_rate")
        kind = name.removesuffix("_slope").removesuffix("_rest")
        rate = _RATES.get(kind, "")
        for index in np.ndindex(value.shape[1:]):
            if len(index) > 1 and symmetric and index[1] < index[0]:
                continue
            first, *others = (axis[i] for axis, i in zip((rows, columns, joints), index, strict=False))
            head = "_d_".join([f"{stem}_{'_'.join(one[0] for one in (first, *others[:1]))}", *(by[0] for by in others[1:])])
            if kind in _INERTIAS:
                coupled, *by_joints = others or [first]
                units = [inertia_unit_of(first[2], coupled[2]), *(by[1] for by in by_joints)]
            else:
                units = [first[1 if name in _OF_POSITIONS else 2] + rate, *(other[1] for other in others)]
            unit = "/".join(units)
            yield f"{head} [{unit}]", value[(slice(None), *index)]


# Names in heads that differ from the quantity's name; additional parts of units; and the quantities whose unit begins with
# that of a position. All other units begin with an effort.
_STEMS = {"ratio": "G", "ratio_slope": "dG"}
_INERTIAS = ("inertia", "armature")
_RATES = {"damping": ".s", "motor_kd": ".s", "joint_kd": ".s"}
_RATES |= {"speed_alone": "/s", "speed_box": "/s"}
_OF_POSITIONS = ("joint_position", "motor_position", "speed_alone", "speed_box", "ratio", "ratio_slope", "friction_rate")


def _effort_columns(name: str, value: np.ndarray, joints: list) -> Iterator[tuple[str, np.ndarray]]:
    for k, joint in enumerate(joints):
        if name == "effort_box":
            for end, word in enumerate(("least", "largest")):
                yield f"effort_{word}_{joint[0]} [{joint[2]}]", value[:, k, end]
        else:
            for corner in range(value.shape[1]):
                yield f"effort_corner_{corner}_{joint[0]} [{joint[2]}]", value[:, corner, k]
