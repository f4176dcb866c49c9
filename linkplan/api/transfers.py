"""`transfer`: efforts, inertia, friction and gains converted between motors and output joints of a linkage."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from linkplan.api.command import command
from linkplan.api.inputs import PlanLike, Subject, numbers, plan_of, subject_of
from linkplan.api.reporting import Progress, listener
from linkplan.models.errors import LinkplanError, ProblemError, choose
from linkplan.models.transfer.rest import OutputMotion, rest_effort
from linkplan.planner.problem.settings import to_toml_types
from linkplan.studies.handover.transfer.columns import arrays_of
from linkplan.studies.handover.transfer.serial_study import Serial, errors_along, motion_of_samples
from linkplan.studies.handover.transfer.serial_urdf import urdf_notes, urdf_text
from linkplan.studies.handover.transfer.study import Transfer, transfer_study
from linkplan.studies.handover.transfer.transfer_blocks import transfer_blocks, transfer_report
from linkplan.studies.handover.transfer.transfer_figures import TransferFigures, transfer_figures
from linkplan.studies.output.result import MechanismResult

if TYPE_CHECKING:
    from linkplan.studies.output.document import Block, Report
    from linkplan.studies.output.figure_spec import FigureSpec

Gains = float | Sequence[float]
Rows = Sequence[Sequence[float]] | np.ndarray


@command(
    "convert efforts, inertia, friction and gains between motors and output joints of a linkage, as tables",
    record="transfer",
    showing=("report", "parquet"),
)
def transfer(
    subject: Subject,
    joints: Sequence[str],
    *,
    tolerance: float = 1e-3,
    range_deg: Mapping[str, Sequence[float]] | None = None,
    range_m: Mapping[str, Sequence[float]] | None = None,
    motor_speed: Gains | None = None,
    joint_kp: Gains | None = None,
    joint_kd: Gains | None = None,
    motor_kp: Gains | None = None,
    motor_kd: Gains | None = None,
    along: PlanLike | None = None,
    progress: Progress | None = None,
) -> TransferResult:
    """Return the transfer table of output joints, which relates motors and joints of a linkage.

    Motor velocity = G joint velocity, joint effort = G^T motor effort, so motor power equals joint power. A motor's
    position is its gear times its joint's position, as MuJoCo's actuator length. Radians, metres and SI units throughout.

    Args:
        subject: a mechanism, a `Problem`, or the name or path of either, in any coordinates. A problem gives the effort
            limits and the motors' top speeds.
        joints: one to three output joints, which determine the motors. Other independent coordinates rest at home.
        tolerance: the allowed error of linear interpolation in the table, as a share of each quantity's largest value.
        range_deg: [low, high] [deg] of an output hinge; by default its whole reach.
        range_m: likewise, of a slide [m].
        motor_speed: the motors' top speeds [rad/s or m/s], one for all or one each.
        joint_kp: joints' stiffness [N.m/rad or N/m] to convert to the motors, one for all or one each.
        joint_kd: joints' damping [N.m.s/rad or N.s/m], likewise.
        motor_kp: motors' stiffness to convert to the joints.
        motor_kd: motors' damping, likewise.
        along: a plan of the same model, or its path; the errors of models without loops are computed along its motion.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: if the joints cannot be coordinates at home, for example at a dead centre, or a value is invalid.

    Example::

        table = linkplan.transfer("optimus-knee", ["C"])
        print(table.message)
    """
    if isinstance(joints, str) or not isinstance(joints, Sequence) or not all(isinstance(name, str) for name in joints):
        raise ProblemError(f"joints must be a list of names, got {joints!r}")
    mechanism, problem = subject_of(subject)
    say = listener(progress)
    gains = {"joint_kp": joint_kp, "joint_kd": joint_kd, "motor_kp": motor_kp, "motor_kd": motor_kd}
    ends = {}
    for key, table in (("range_deg", range_deg), ("range_m", range_m)):
        if not isinstance(table, Mapping | None):
            raise ProblemError(f"{key} must be a table of joint = [low, high], got {table!r}")
        for name, both in to_toml_types(table or {}).items():
            joint = mechanism.joints[mechanism.joint_index(name, ProblemError)]
            values = numbers(both, f"{key}.{name}")
            if len(values) != 2 or joint.unit != key.removeprefix("range_"):
                raise ProblemError(f"{key}.{name} must be [low, high] of a joint in {joint.unit}, got {both!r}")
            ends[name] = (joint.read(values[0]), joint.read(values[1]))
    found = transfer_study(
        mechanism,
        list(joints),
        tolerance=tolerance,
        ends=ends,
        problem=problem,
        motor_speeds=() if motor_speed is None else numbers(motor_speed, "motor_speed"),
        along=None if along is None else plan_of(along, say, "compare with"),
        gains={name: numbers(values, name) for name, values in gains.items() if values is not None},
        say=say,
    )
    return TransferResult(figures=transfer_figures(found), found=found)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class TransferResult(MechanismResult):
    """A transfer table. `str(result)` is the report; `to_dict()` has the linkage at home, the ends of the map and errors."""

    record_name = "transfer"
    has_parquet = True
    figures: TransferFigures
    found: Transfer

    @property
    def kept(self) -> bool:
        """Whether the table's interpolation error is within the tolerance."""
        return self.figures.kept

    @property
    def passed(self) -> bool:
        """Whether the table's interpolation error is within the tolerance."""
        return self.kept

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Every quantity over the nodes (n, ...): "joint_position", "motor_position", "ratio" (G), "inertia", ..."""
        return arrays_of(self.found)

    def at(self, name: str, positions_rad: Rows) -> np.ndarray:
        """Return a quantity of the table by linear interpolation; NaN outside the map.

        Args:
            name: "motor_position", "ratio" (G), "ratio_slope", "inertia", "armature", "damping", "friction" or "gravity".
            positions_rad: of the output joints (n, n_joints) [rad or m].
        """
        grid = self.found.table.grid
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
        text = urdf_text(self.found)
        if text is None:
            raise LinkplanError(f"no URDF: {urdf_notes(self.found)[0]}")
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
        table, serial = self.found.table, self._serial()
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
        serial, grid = self._serial(), self.found.table.grid
        s, v, a = (
            np.atleast_2d(np.asarray(rows, dtype=float)) for rows in (position_rad, velocity_rad_s, acceleration_rad_s2)
        )
        if not s.shape == v.shape == a.shape or s.shape[1] != len(grid.axes):
            raise ProblemError(
                f"position, velocity and acceleration must be (n, {len(grid.axes)}), got {s.shape}, {v.shape}, {a.shape}"
            )
        motion = OutputMotion(time_s=np.arange(float(len(s))), position=s, velocity=v, acceleration=a)
        return rest_effort(self.found.outputs, serial.model, serial.rest, grid, motion)

    def _serial(self) -> Serial:
        if self.found.serial is None:
            raise LinkplanError(self.found.serial_note)
        return self.found.serial

    def blocks(self) -> list[Block]:
        """Return the table and the curves."""
        return transfer_blocks(self.found)

    def document(self) -> Report:
        """Return the report."""
        return transfer_report(self.found)

    def write_files(self, place: Path, *, parquet: bool) -> None:
        """Write the tables (CSV, NPZ, with `parquet` Parquet too) and the serial equivalent."""
        from linkplan.studies.handover.transfer.files import write_files

        write_files(self.found, place, parquet=parquet)

    def figure_specs(self) -> Iterator[tuple[str, FigureSpec]]:
        """Yield transfer, the curves over each joint's range."""
        from linkplan.studies.handover.transfer.files import transfer_figure

        yield "transfer", transfer_figure(self.found)
