"""The quantities of a transfer table, as columns with units in their heads, and as arrays for NPZ."""

import json
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from linkplan.models.transfer.polytope import (
    MOST_CORNER_MOTORS,
    effort_box,
    effort_corners,
    speed_alone,
    speed_box,
)
from linkplan.models.tree.joints import Joint, inertia_unit_of
from linkplan.studies.handover.transfer.study import Transfer, carried_gains
from linkplan.studies.output.quantities import Curve, Quantity, curves_of


def _per(side: int, rate: str = "") -> Callable[..., str]:
    """Return a function of parts: the unit of the first one's position (0) or effort (1) per position of each other."""
    return lambda first, *others: "/".join([first.si_units[side] + rate, *(other.si_units[0] for other in others)])


def _inertia(first: Joint, second: Joint, *others: Joint) -> str:
    return "/".join([inertia_unit_of(first.si_units[1], second.si_units[1]), *(other.si_units[0] for other in others)])


def _of(kinds: str, field: str, unit: Callable[..., str], meaning: str, column: str = "", **drawn: str) -> Quantity:
    """Return a quantity of parts; its column has by default its name and theirs."""
    of = tuple(kinds.split())
    return Quantity(field=field, of=of, unit=unit, column=column or field + "_{}" * len(of), meaning=meaning, **drawn)


_ALL = (
    _of("joint", "joint_position", _per(0), "positions of the output joints"),
    _of("motor", "motor_position", _per(0), "motor positions: gear times joint position, as MuJoCo's actuator length",
        plot="Motor positions", label="motor position"),
    _of("motor joint", "ratio", _per(0), "G: motor velocity = G joint velocity, joint effort = G^T motor effort",
        "G_{}_{}", plot="Transmission G", label="G", line="{} / {}"),
    _of("motor joint joint", "ratio_slope", _per(0), "dG/ds: G' = the sum over its last axis of dG/ds times joint velocity",
        "dG_{}_{}_d_{}"),
    _of("joint joint", "inertia", _inertia, "reflected inertia of all that moves with the output joints",
        plot="Reflected inertia", label="inertia"),
    _of("joint joint", "armature", _inertia, "the part of it that is armature of joints and rotors"),
    _of("joint joint", "damping", _per(1, ".s"), "reflected viscous damping"),
    _of("joint", "friction", _per(1), "dry friction on each joint while it slides alone"),
    _of("joint", "gravity", _per(1), "effort that balances gravity",
        plot="Effort that balances gravity", label="effort"),
    _of("joint", "hold", _per(1), "effort at rest: gravity, springs and constant forces"),
    _of("joint end", "effort_box", lambda joint, _: joint.si_units[1], "least and largest effort on each joint",
        "effort_{1}_{0}"),
    _of("joint corner", "effort_corners", lambda joint, _: joint.si_units[1],
        "joint efforts at the corners of the motors' limits, motors counted in binary, last one first",
        "effort_corner_{1}_{0}"),
    _of("joint", "speed_alone", _per(0, "/s"), "largest speed of each joint while the others rest"),
    _of("joint", "speed_box", _per(0, "/s"), "largest speed of each joint in any motion"),
    _of("motor motor", "motor_kp", _per(1), "motor stiffness that gives the joints the requested stiffness"),
    _of("motor motor", "motor_kd", _per(1, ".s"), "motor damping that gives the joints the requested damping"),
    _of("joint joint", "joint_kp", _per(1), "joint stiffness that the motors' stiffness gives"),
    _of("joint joint", "joint_kd", _per(1, ".s"), "joint damping that the motors' damping gives"),
    _of("joint joint", "inertia_rest", _inertia, "inertia that the serial equivalent lacks"),
    _of("joint joint joint", "inertia_rest_slope", _inertia, "its derivatives by the joint positions, along the last axis",
        "inertia_rest_slope_{}_{}_d_{}"),
    _of("joint joint", "damping_rest", _per(1, ".s"), "damping that the serial equivalent lacks"),
    _of("rubbing joint", "friction_rate", _per(0),
        "rates of the linkage's joints with dry friction, over those of the output joints"),
    _of("joint", "effort_rest", _per(1),
        "effort at rest (weight, springs and constant forces) that the serial equivalent lacks"),
    _of("", "status", lambda: "1",
        "0: on the map; 1: the loops do not close; 2: near a singular pose; 3: outside the map, for interpolation at"
        " the edge of the inverse map; 100 + k: joint k is beyond its range"),
)  # fmt: skip
# The quantities by name; joints are in the order of the table's axes, motors in the file's order.
QUANTITIES = {one.field: one for one in _ALL}


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


def curves(transfer: Transfer, name: str, values: np.ndarray) -> Iterator[Curve]:
    """Yield the curves of a quantity with values (n, ...)."""
    serial, joints = transfer.serial, transfer.outputs.mechanism.joints
    corners: list[tuple[int, str]] = []
    if name == "effort_corners":  # (n, corners, joints)
        values = values.swapaxes(1, 2)
        corners = [(k, str(k)) for k in range(values.shape[2])]
    parts = {
        "joint": list(enumerate(transfer.outputs.joints)),
        "motor": list(enumerate(transfer.outputs.actuators)),
        "end": list(enumerate(("least", "largest"))),
        "corner": corners,
        "rubbing": [] if serial is None else [(k, joints[i]) for k, i in enumerate(serial.model.rubbing)],
    }
    return curves_of(QUANTITIES[name], parts, values)


def columns_of(transfer: Transfer) -> dict[str, np.ndarray]:
    """Return the table as columns (n,); heads are like "inertia_pitch_roll [kg m2]"."""
    return _columns(transfer, arrays_of(transfer))


def inverse_columns(transfer: Transfer) -> dict[str, np.ndarray] | None:
    """Return the inverse map, joint positions over motor positions, as columns; None without one."""
    inverse = transfer.table.inverse
    if inverse is None:
        return None
    joints = inverse.values["joint_position"].reshape(len(inverse.points), -1)
    arrays = {"motor_position": inverse.points, "joint_position": joints, "status": inverse.values["status"].ravel()}
    return _columns(transfer, arrays)


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
        "meaning": {name: QUANTITIES[name].meaning for name in values},
    }
    return arrays | {"about": np.array(json.dumps(about))}


def _columns(transfer: Transfer, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the columns (n,) of quantities (n, ...) by their heads."""
    return {
        f"{QUANTITIES[name].column.format(*curve.names)} [{curve.unit}]": curve.values
        for name, values in arrays.items()
        for curve in curves(transfer, name, values)
    }
