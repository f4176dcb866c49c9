"""A run in a tracker's result: its log by names of joints and actuators, in degrees or metres, like a plan's samples.

Its tables (CSV, NPZ and Parquet) have one row for each control instant, with units in the column names.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from linkplan.controllers.rollout import Rollout
from linkplan.models.extras import load_extra
from linkplan.models.mechanism import Mechanism
from linkplan.models.tree.joints import shown_by_name
from linkplan.planner.files.columns import csv_bytes, head_of, parquet_bytes
from linkplan.studies.compare.compare import Comparison

if TYPE_CHECKING:
    import pandas  # pyright: ignore[reportMissingImports]


def run_columns(mechanism: Mechanism, rollout: Rollout) -> dict[str, np.ndarray]:
    """Return a run's columns (n,) by name, with units in the names.

    The columns are time_s; the desired position, position, error and velocity of each independent joint (O_ref_deg, O_deg,
    O_error_deg, O_deg_s); the position of each dependent joint; the commanded and applied effort of each actuator
    (act_O_commanded_Nm, act_O_applied_Nm); closure_gap_m; and closure_gap_rad if angles are tied.
    """
    found = {"time_s": rollout.time_s}
    for k, joint in enumerate(mechanism.independent_joints):
        found[head_of(f"{joint.name}_ref", joint.unit)] = joint.shown(rollout.reference_rad[:, k])
        found[head_of(joint.name, joint.unit)] = joint.shown(rollout.position_rad[:, k])
        found[head_of(f"{joint.name}_error", joint.unit)] = joint.shown(rollout.error_rad[:, k])
        found[head_of(joint.name, f"{joint.unit}/s")] = joint.shown(rollout.velocity_rad_s[:, k])
    for index in mechanism.dependent.tolist():
        joint = mechanism.joints[index]
        found[head_of(joint.name, joint.unit)] = joint.shown(rollout.pose_rad[:, index])
    for k, actuator in enumerate(mechanism.actuators):
        found[head_of(f"{actuator.name}_commanded", actuator.unit)] = rollout.commanded[:, k]
        found[head_of(f"{actuator.name}_applied", actuator.unit)] = rollout.applied[:, k]
    angles = {"closure_gap_rad": rollout.gap_rad} if len(rollout.gap_rad) else {}
    return found | {"closure_gap_m": rollout.gap_m} | angles


def save_time_series(comparison: Comparison, folder: Path, *, parquet: bool = False) -> None:
    """Write every run of a comparison into a folder: nominal-pd.csv, mismatch-pd.npz, ...

    With `parquet`, Parquet files are written too.
    """
    for side, runs in ((comparison.stem, comparison.nominal), ("mismatch", comparison.mismatched)):
        for number, (tracker, rollout) in enumerate(runs.items()):
            plain = "".join(letter if letter.isalnum() or letter in "+-_" else "_" for letter in tracker)
            stem = f"{side}-{plain}" if [*map(str.lower, runs)].count(tracker.lower()) == 1 else f"{side}-{number}-{plain}"
            columns = run_columns(comparison.plan.problem.mechanism, rollout)
            np.savez(folder / f"{stem}.npz", **columns)  # pyright: ignore[reportArgumentType]  arrays by name
            (folder / f"{stem}.csv").write_bytes(csv_bytes(columns))
            if parquet:
                about = {"plan": comparison.plan.problem.name, "tracker": tracker, "run": side}
                (folder / f"{stem}.parquet").write_bytes(parquet_bytes(columns, about))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class NamedRun(Rollout):
    """The log of a run by names: `position_deg["O"]` (n,) [deg, or m of slides] at the control instants `time_s`."""

    mechanism: Mechanism

    @classmethod
    def of(cls, run: Rollout, mechanism: Mechanism) -> Self:
        """Return a run with the names of its mechanism."""
        return cls(mechanism=mechanism, **{field.name: getattr(run, field.name) for field in fields(Rollout)})

    @property
    def position_deg(self) -> dict[str, np.ndarray]:
        """The positions (n,) [deg or m] of all joints by name."""
        return shown_by_name(self.mechanism.joints, self.pose_rad)

    @property
    def reference_deg(self) -> dict[str, np.ndarray]:
        """The desired positions (n,) [deg or m] of the independent joints by name."""
        return shown_by_name(self.mechanism.independent_joints, self.reference_rad)

    @property
    def error_deg(self) -> dict[str, np.ndarray]:
        """The position errors (n,) [deg or m] of the independent joints by name: desired minus actual."""
        return shown_by_name(self.mechanism.independent_joints, self.error_rad)

    @property
    def speed_deg_s(self) -> dict[str, np.ndarray]:
        """The speeds (n,) [deg/s or m/s] of the independent joints by name."""
        return shown_by_name(self.mechanism.independent_joints, self.velocity_rad_s)

    @property
    def effort(self) -> dict[str, np.ndarray]:
        """The applied efforts (n,) [N.m or N] by actuator, averaged over each control period."""
        return {one.name: values for one, values in zip(self.mechanism.actuators, self.applied.T, strict=True)}

    def __repr__(self) -> str:
        return f"NamedRun({len(self.time_s)} control instants, {self.time_s[-1]:.6g} s: {', '.join(self.position_deg)})"

    def to_frame(self) -> pandas.DataFrame:
        """Return the log as a pandas table, with a row for each control instant and units in the columns' names.

        Raises:
            MissingPackageError: if pandas is not installed.
        """
        return load_extra("pandas", "NamedRun.to_frame").DataFrame(run_columns(self.mechanism, self))
