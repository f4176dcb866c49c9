"""The result of `linkplan transfer`, whose fields are the record `transfer.json`: the linkage at home, ends and errors."""

from typing import Any

import numpy as np
from msgspec import Struct, field

from linkplan.models.mechanism import Mechanism
from linkplan.models.transfer.polytope import effort_box
from linkplan.models.transfer.rest import SerialErrors
from linkplan.studies.handover.transfer.serial_study import Serial, left_out
from linkplan.studies.handover.transfer.serial_urdf import reductions, urdf_notes
from linkplan.studies.handover.transfer.study import CONVENTION, Transfer, carried_gains
from linkplan.studies.handover.transfer.transfer_blocks import notes

_AT_HOME = ("motor_position", "ratio", "inertia", "armature", "damping", "friction", "gravity", "hold")


class TransferFigures(Struct, frozen=True, kw_only=True, eq=False):
    """A transfer table in numbers; positions in rad or m, everything in SI, as in the files of the table.

    `interpolation_error` is a share of each quantity's largest size, its `scale`. `ends` has the position, reason and margin
    of both ends of each joint's range. `serial` has the joints' properties of the serial equivalent, what it ignores, and
    its errors along a motion; it and `serial_urdf` are None without a serial equivalent.
    """

    mechanism_name: str = field(name="mechanism")
    message: str
    convention: str
    joints: list[str]
    joint_units: list[tuple[str, str]]
    motors: list[str]
    motor_units: list[tuple[str, str]]
    nodes: list[int]
    tolerance: float
    kept: bool
    interpolation_error: dict[str, float]
    scale: dict[str, float]
    points_checked: int
    inverse_error: float | None
    inverse_answered: float | None
    ends: dict[str, list[dict[str, Any]]]
    dead_centres: list[dict[str, Any]]
    home: dict[str, Any]
    serial: dict[str, Any] | None
    serial_note: str
    serial_urdf: dict[str, Any] | None
    notes: list[str]


def transfer_figures(transfer: Transfer) -> TransferFigures:
    """Return the figures of a transfer table."""
    table, outputs, home = transfer.table, transfer.outputs, transfer.home
    inverse, serial, motors = table.inverse, transfer.serial, outputs.actuators
    return TransferFigures(
        mechanism_name=outputs.mechanism.name,
        message=transfer.message,
        convention=CONVENTION,
        joints=[joint.name for joint in outputs.joints],
        joint_units=[joint.si_units for joint in outputs.joints],
        motors=[motor.name for motor in motors],
        motor_units=[motor.si_units for motor in motors],
        nodes=[len(axis) for axis in table.grid.axes],
        tolerance=table.tolerance,
        kept=transfer.kept,
        interpolation_error=table.grid.errors,
        scale=table.grid.scale,
        points_checked=table.grid.checked,
        inverse_error=None if inverse is None else inverse.errors["joint_position"],
        inverse_answered=None if inverse is None else inverse.answered,
        ends={
            joint.name: [{"position": end.position, "reason": end.reason, "margin": end.margin} for end in both]
            for joint, both in zip(outputs.joints, table.ends, strict=True)
        },
        dead_centres=[{"motor": motors[m].name, "position": x} for m, x in table.dead_centres],
        home={
            "joint_position": outputs.home,
            **{name: getattr(home, name)[0] for name in _AT_HOME},
            "effort_box": effort_box(home.ratio, transfer.effort_limit)[0],
            **{name: gains[0] for name, gains in carried_gains(transfer, home.ratio).items()},
        },
        serial=None if serial is None else _serial_figures(serial, outputs.mechanism),
        serial_note=transfer.serial_note,
        serial_urdf=None if serial is None else _urdf_figures(transfer),
        notes=notes(transfer),
    )


def _serial_figures(serial: Serial, mechanism: Mechanism) -> dict[str, Any]:
    model, errors, closed = serial.model, serial.errors, mechanism.joints
    names = [joint.name for joint in model.outputs.joints]
    return {
        "joints": names,
        "armature": model.armature,
        "damping": model.damping,
        "friction": model.friction,
        "friction_joints": {closed[i].name: force for i, force in zip(model.rubbing, model.rubbing_force, strict=True)},
        "effort_limit": model.effort_limit,
        "welded": list(model.removed),
        "left_out": left_out(serial),
        "errors": None if errors is None else _error_figures(errors, names),
    }


def _error_figures(errors: SerialErrors, names: list[str]) -> dict[str, Any]:
    """Return the largest effort of each joint, and the rms and largest error of each model."""

    def by(values: np.ndarray) -> dict[str, float]:
        return dict(zip(names, values, strict=True))

    rms = errors.rms()
    sizes = {name: {"rms": by(rms[name]), "max": by(np.abs(x).max(axis=0))} for name, x in errors.named().items()}
    return {"largest_effort": by(np.abs(errors.effort).max(axis=0)), **sizes}


def _urdf_figures(transfer: Transfer) -> dict[str, Any]:
    """Return the transmissions of the serial equivalent's URDF, and what the URDF lacks."""
    joints, motors = ([one.name for one in of] for of in (transfer.outputs.joints, transfer.outputs.actuators))
    found = [{"joint": name, "motor": motors[motor], "reduction": reduction, "offset": offset}
             for name, (motor, reduction, offset) in zip(joints, reductions(transfer), strict=False)]  # fmt: skip
    return {"transmissions": found, "left_out": urdf_notes(transfer)}
