"""Tracking runs as CSV, NPZ and Parquet tables: one row for each control instant, with units in the column names."""

from pathlib import Path

import numpy as np

from linkplan.controllers.rollout import Rollout
from linkplan.models.mechanism import Mechanism
from linkplan.planner.files.columns import csv_bytes, head_of, parquet_bytes
from linkplan.studies.compare.compare import Comparison


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
