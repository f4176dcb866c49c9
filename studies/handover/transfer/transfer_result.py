"""The result of `linkplan transfer`, whose fields are the record `transfer.json`: the linkage at home, ends and errors."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct, field

from linkplan.models.errors import LinkplanError, ProblemError, choose
from linkplan.models.mechanism import Mechanism
from linkplan.models.transfer.polytope import effort_box
from linkplan.models.transfer.rest import OutputMotion, SerialErrors, rest_effort
from linkplan.planner.files.columns import csv_bytes, parquet_bytes
from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.studies.handover.transfer.columns import arrays_of, columns_of, inverse_columns, npz_arrays
from linkplan.studies.handover.transfer.frameworks import frameworks_text
from linkplan.studies.handover.transfer.serial_study import Serial, along_columns, errors_along, left_out, motion_of_samples
from linkplan.studies.handover.transfer.serial_urdf import reductions, urdf_notes, urdf_text
from linkplan.studies.handover.transfer.site_map import SiteMap, site_blocks, site_maps, site_pictures
from linkplan.studies.handover.transfer.study import CONVENTION, Transfer, carried_gains
from linkplan.studies.handover.transfer.transfer_blocks import notes, transfer_blocks, transfer_plots
from linkplan.studies.output.document import Block, Report, Section
from linkplan.studies.output.figure_spec import FigureSpec
from linkplan.studies.output.report_file import report_of
from linkplan.studies.output.result import MechanismResult

Rows = Sequence[Sequence[float]] | np.ndarray
_AT_HOME = ("motor_position", "ratio", "inertia", "armature", "damping", "friction", "gravity", "hold")


class TransferResult(MechanismResult, Struct, frozen=True, kw_only=True, eq=False):
    """A transfer table in numbers; positions in rad or m, everything in SI, as in the files of the table.

    `interpolation_error` is a share of each quantity's largest size, its `scale`. `ends` has the position, reason and margin
    of both ends of each joint's range. `serial` has the joints' properties of the serial equivalent, what it ignores, and
    its errors along a motion; it and `urdf` are None without a serial equivalent. `sites` has the ellipses and the polytope
    of sites at home.
    """

    record_name = "transfer"
    has_parquet = True

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
    urdf: dict[str, Any] | None = field(name="serial_urdf")
    notes: list[str]
    sites: dict[str, dict[str, Any]]
    maps: Beside[list[SiteMap]] = NOT_READ
    transfer: Beside[Transfer] = NOT_READ

    @property
    def passed(self) -> bool:
        """Whether the table's interpolation error is within the tolerance."""
        return self.kept

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Every quantity over the nodes (n, ...): "joint_position", "motor_position", "ratio" (G), "inertia", ..."""
        return arrays_of(self.transfer)

    def at(self, name: str, positions_rad: Rows) -> np.ndarray:
        """Return a quantity of the table by linear interpolation; NaN outside the map.

        Args:
            name: "motor_position", "ratio" (G), "ratio_slope", "inertia", "armature", "damping", "friction" or "gravity".
            positions_rad: of the output joints (n, n_joints) [rad or m].
        """
        grid = self.transfer.table.grid
        names = [key for key in grid.values if key not in ("pose", "status")]
        return grid.at(choose("quantity", name, names, ProblemError), np.atleast_2d(np.asarray(positions_rad, dtype=float)))

    @property
    def serial_mjcf(self) -> str:
        """Return the serial equivalent as MJCF: the model without loops, with the linkage's reflected inertia and losses.

        Raises:
            LinkplanError: if the linkage has none, with the reason.
        """
        return self._serial().model.text

    @property
    def serial_urdf(self) -> str:
        """Return the serial equivalent as URDF, with a transmission if the ratio is constant.

        `to_dict()["serial_urdf"]` lists what a URDF cannot express.

        Raises:
            LinkplanError: if the linkage has none, with the reason.
        """
        self._serial()
        text = urdf_text(self.transfer)
        if text is None:
            raise LinkplanError(f"no URDF: {urdf_notes(self.transfer)[0]}")
        return text

    def errors_along(self, time_s: Sequence[float] | np.ndarray, position_rad: Rows) -> dict[str, np.ndarray]:
        """Return the errors of models without loops along a motion of the output joints, in N.m or N.

        Args:
            time_s: instants (n,) [s].
            position_rad: output positions (n, n_joints) [rad, or m for slides], interpolated by a spline of degree five.

        Returns:
            Arrays (n, n_joints): the "effort" that the motion needs, and the errors of the "static map" (a tree without
            reflected quantities), the "serial equivalent", and the "serial with table".
        """
        table, serial = self.transfer.table, self._serial()
        found = errors_along(table, serial.model, serial.rest, motion_of_samples(table.outputs, time_s, position_rad))
        return {"effort": found.effort, **found.named()}

    def rest_effort(self, position_rad: Rows, velocity_rad_s: Rows, acceleration_rad_s2: Rows) -> np.ndarray:
        """Return the efforts (n, n_joints) [N.m or N] to subtract from those of the serial equivalent's joints.

        They are interpolated in the table; NaN outside the map.

        Args:
            position_rad: of the output joints (n, n_joints) [rad, or m of slides].
            velocity_rad_s: likewise, per second.
            acceleration_rad_s2: likewise, per second squared.
        """
        serial, grid = self._serial(), self.transfer.table.grid
        s, v, a = (
            np.atleast_2d(np.asarray(rows, dtype=float)) for rows in (position_rad, velocity_rad_s, acceleration_rad_s2)
        )
        if not s.shape == v.shape == a.shape or s.shape[1] != len(grid.axes):
            raise ProblemError(
                f"position, velocity and acceleration must be (n, {len(grid.axes)}), got {s.shape}, {v.shape}, {a.shape}"
            )
        motion = OutputMotion(time_s=np.arange(float(len(s))), position=s, velocity=v, acceleration=a)
        return rest_effort(self.transfer.outputs, serial.model, serial.rest, grid, motion)

    def _serial(self) -> Serial:
        if self.transfer.serial is None:
            raise LinkplanError(self.transfer.serial_note)
        return self.transfer.serial

    def blocks(self) -> list[Block]:
        """Return the table and the curves."""
        return [
            *transfer_blocks(self.transfer),
            *(block for one in self.maps for block in site_blocks(one)),
            *site_pictures(self.maps),
        ]

    def document(self) -> Report:
        """Return the report."""
        first = Section(title=f"Motors and {', '.join(self.joints)}", blocks=self.blocks()[1:])
        return report_of(f"Transfer table of {self.mechanism_name}", self.message, self.kept, [first])

    def write_files(self, place: Path, *, parquet: bool) -> None:
        """Write the tables (CSV, NPZ, with `parquet` Parquet too), actuators of frameworks and the serial equivalent."""
        transfer, serial = self.transfer, self.transfer.serial
        of_sites = {head: values for one in self.maps for head, values in one.columns.items()}
        tables = {"table": columns_of(transfer) | of_sites, "inverse": inverse_columns(transfer)}
        about = {"mechanism": self.mechanism_name, "joints": ",".join(self.joints)}
        for name, columns in tables.items():
            if columns is None:
                continue
            (place / f"{name}.csv").write_bytes(csv_bytes(columns))
            if parquet:
                (place / f"{name}.parquet").write_bytes(parquet_bytes(columns, about))
        if serial is not None:
            (place / "serial.xml").write_text(serial.model.text, encoding="utf-8")
            urdf = urdf_text(transfer)
            if urdf is not None:
                (place / "serial.urdf").write_text(urdf, encoding="utf-8")
            if serial.errors is not None:
                (place / "along.csv").write_bytes(csv_bytes(along_columns(serial)))
        (place / "actuators.py").write_text(frameworks_text(transfer), encoding="utf-8")
        np.savez_compressed(place / "table.npz", **npz_arrays(transfer))  # pyright: ignore[reportArgumentType]  arrays by name

    def figure_specs(self) -> Iterator[tuple[str, FigureSpec]]:
        """Yield the figure "transfer", the curves over each joint's range, and "sites", their forces and speeds at home."""
        title = f"{self.mechanism_name}: {self.message}"
        yield "transfer", FigureSpec(panels=transfer_plots(self.transfer), title=title, columns=2)
        if pictures := site_pictures(self.maps):
            yield "sites", FigureSpec(panels=pictures, title=title, columns=2)


def transfer_result(transfer: Transfer, sites: Sequence[str] = ()) -> TransferResult:
    """Return the result of a transfer table, with sites of the model."""
    maps = site_maps(transfer, sites)
    table, outputs, home = transfer.table, transfer.outputs, transfer.home
    inverse, serial, motors = table.inverse, transfer.serial, outputs.actuators
    return TransferResult(
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
        urdf=None if serial is None else _urdf_figures(transfer),
        notes=notes(transfer),
        sites={one.site: one.figures() for one in maps},
        maps=maps,
        transfer=transfer,
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
