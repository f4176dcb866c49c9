"""A run in a tracker's result: its log by names of joints and actuators, in degrees or metres, like a plan's samples."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Self

import numpy as np

from linkplan.controllers.rollout import Rollout
from linkplan.models.extras import load_extra
from linkplan.models.mechanism import Mechanism
from linkplan.models.tree.joints import shown_by_name
from linkplan.studies.compare.time_series import run_columns

if TYPE_CHECKING:
    import pandas  # pyright: ignore[reportMissingImports]


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
