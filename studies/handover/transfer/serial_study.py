"""The serial equivalent of a transfer table, and its errors along motions, as a document."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from linkplan.models.digest import compiled_bytes
from linkplan.models.errors import ModelError, ProblemError
from linkplan.models.transfer.output_map import OutputMap
from linkplan.models.transfer.rest import OutputMotion, SerialErrors, rest_values, serial_errors
from linkplan.models.transfer.serial import SerialModel, serial_model
from linkplan.models.transfer.table import TransferTable
from linkplan.planner.plan.plan import Plan
from linkplan.studies.handover.export.samples import exported_samples
from linkplan.studies.output.document import Block, Plot, Text, table_of
from linkplan.studies.output.lines import TIME, Line, plots

# Fewest samples of a motion for its velocities and accelerations by a spline of degree five.
_FEWEST_SAMPLES = 10


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Serial:
    """The serial equivalent of a linkage, the quantities that it lacks at the table's nodes, and its errors."""

    model: SerialModel
    rest: dict[str, np.ndarray]
    errors: SerialErrors | None


def serial_of(
    table: TransferTable, effort_limit: np.ndarray, motion: OutputMotion | None = None
) -> tuple[Serial | None, str]:
    """Return the serial equivalent of a table, with its errors along a motion if one is given; or None and the reason."""
    try:
        model = serial_model(table.outputs, effort_limit)
    except ModelError as error:
        return None, str(error)
    rest = rest_values(table.outputs, model, table.grid)
    return Serial(model=model, rest=rest, errors=None if motion is None else errors_along(table, model, rest, motion)), ""


def errors_along(
    table: TransferTable, model: SerialModel, rest: dict[str, np.ndarray], motion: OutputMotion
) -> SerialErrors:
    """Return the errors along a motion.

    Raises:
        ProblemError: if it leaves the table.
    """
    for k, joint in enumerate(table.outputs.joints):
        low, high = table.grid.axes[k][[0, -1]]
        first, last = motion.position[:, k].min(), motion.position[:, k].max()
        if first < low or last > high:
            raise ProblemError(
                f"the motion takes {joint.name} from {joint.text(first)} to {joint.text(last)} {joint.unit}; the table goes"
                f" from {joint.text(low)} to {joint.text(high)} {joint.unit}"
            )
    return serial_errors(table.outputs, model, rest, table.grid, motion)


def motion_of_plan(plan: Plan, outputs: OutputMap) -> OutputMotion:
    """Return a plan's motion of the output joints.

    Raises:
        ProblemError: if the plan is of another model, or has no motion.
    """
    plan.require_motion("compare with")
    mechanism = plan.problem.mechanism
    if compiled_bytes(mechanism.model) != compiled_bytes(outputs.mechanism.model):
        raise ProblemError(
            f"the plan '{plan.problem.name}' has another model or payload than the table; give its problem file"
        )
    samples = exported_samples(plan)
    index = [mechanism.joint_index(joint.name) for joint in outputs.joints]
    return OutputMotion(
        time_s=samples.time_s,
        position=samples.q[:, index],
        velocity=samples.rates[:, index],
        acceleration=samples.accelerations()[:, index],
    )


def motion_of_samples(outputs: OutputMap, time_s: ArrayLike, position: ArrayLike) -> OutputMotion:
    """Return the motion through output positions (n, n_o) [rad or m] at times (n,) [s], a spline of degree five.

    Raises:
        ProblemError: for other shapes, fewer than ten samples, or times that do not increase.
    """
    import scipy.interpolate

    time, path = (np.asarray(values, dtype=float) for values in (time_s, position))
    path = path[:, None] if path.ndim == 1 else path
    if time.ndim != 1 or path.shape != (len(time), len(outputs.joints)) or len(time) < _FEWEST_SAMPLES:
        raise ProblemError(
            f"a motion needs times (n,) and positions (n, {len(outputs.joints)}) with n of at least {_FEWEST_SAMPLES}, got"
            f" {time.shape} and {path.shape}"
        )
    if not (np.isfinite(time).all() and np.isfinite(path).all() and np.all(np.diff(time) > 0)):
        raise ProblemError("a motion's times must increase, and all its numbers must be finite")
    spline = scipy.interpolate.make_interp_spline(time, path, k=5)
    velocity, acceleration = (spline.derivative(k)(time) for k in (1, 2))
    return OutputMotion(time_s=time, position=path, velocity=velocity, acceleration=acceleration)


def left_out(serial: Serial) -> list[str]:
    """Return sentences on the properties that the serial equivalent without its table ignores."""
    model, names = serial.model, [joint.name for joint in serial.model.outputs.joints]
    lost = ", ".join(model.removed)
    found = [
        f"the joints {lost} are welded at home: their bodies do not move with {', '.join(names)} and touch nothing",
        "armature and damping are those at home; their change over the range is in the columns *_rest",
        "the Coriolis and centrifugal efforts of the linkage, and its weight and springs away from home, are in *_rest too",
        "each motor's limits are those of the box at home; the motors together can only produce efforts in a polytope"
        " inside it",
    ]
    if model.rubbing:
        found.append("dry friction is that of each joint moving alone at home; columns friction_rate give it in any motion")
    if len(names) > 1:
        found.append("the linkage's coupling of the joints' accelerations (inertia off the diagonal) is in inertia_rest")
    return found


def serial_blocks(serial: Serial | None, note: str) -> list[Block]:
    """Return the serial equivalent as blocks: its joints' properties, what it ignores, and its errors along a motion."""
    if serial is None:
        return [Text(text=note, tone="note")]
    model = serial.model
    rows = [
        [f"{joint.name} [{joint.si_units[0]}]", joint.si_units[1], *values, *model.effort_limit[k]]
        for k, (joint, *values) in enumerate(
            zip(model.outputs.joints, model.armature, model.damping, model.friction, strict=True)
        )
    ]
    heads = ["joint", "unit of effort", "armature", "damping", "dry friction", "least effort", "largest effort"]
    blocks: list[Block] = [table_of("Serial equivalent: the joints' properties that replace the linkage", heads, rows)]
    blocks += [Text(text=f"left out: {text}", tone="note") for text in left_out(serial)]
    return blocks if serial.errors is None else [*blocks, *error_blocks(serial)]


def error_blocks(serial: Serial) -> list[Block]:
    """Return the errors along a motion as a table and curves."""
    errors, joints = serial.errors, serial.model.outputs.joints
    rows, rms = [], errors.rms()
    for k, joint in enumerate(joints):
        unit, peak = joint.si_units[1], np.abs(errors.effort[:, k]).max()
        for name, off in errors.named().items():
            rows.append([joint.name, name, unit, rms[name][k], np.abs(off[:, k]).max(), peak])
    heads = ["joint", "error of", "unit", "rms", "largest", "effort that the motion needs, largest"]
    return [table_of("Errors of effort along the motion", heads, rows), *error_plots(serial)]


def error_plots(serial: Serial) -> list[Plot]:
    """Return the errors of each joint over time."""
    errors, found = serial.errors, []
    for k, joint in enumerate(serial.model.outputs.joints):
        lines = [Line(name=name, values=off[:, k], unit=joint.si_units[1]) for name, off in errors.named().items()]
        lines.append(
            Line(name="effort that the motion needs", values=errors.effort[:, k], unit=joint.si_units[1], look="dots")
        )
        found += plots(
            f"Effort on {joint.name}, and errors of models without loops", "effort", TIME, errors.motion.time_s, lines
        )
    return found


def along_columns(serial: Serial) -> dict[str, np.ndarray]:
    """Return motion, effort and errors as columns (n,) with units in their heads."""
    errors, found = serial.errors, {"time_s": serial.errors.motion.time_s}
    for k, joint in enumerate(serial.model.outputs.joints):
        position, effort = joint.si_units
        for name, unit in (("position", position), ("velocity", f"{position}/s"), ("acceleration", f"{position}/s2")):
            found[f"{name}_{joint.name} [{unit}]"] = getattr(errors.motion, name)[:, k]
        found[f"effort_{joint.name} [{effort}]"] = errors.effort[:, k]
        for name, off in errors.named().items():
            found[f"error_{name.replace(' ', '_')}_{joint.name} [{effort}]"] = off[:, k]
    return found
