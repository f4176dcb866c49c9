"""The result of `bode` for a plant from chosen inputs to chosen outputs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from linkplan.models.errors import ProblemError, choose
from linkplan.studies.feedback.bode.plant_blocks import plant_figure, plant_report, plant_summary
from linkplan.studies.feedback.bode.plant_result import PlantStudy
from linkplan.studies.feedback.frequency.plant_modes import plant_matrices
from linkplan.studies.output.document import Block, Report
from linkplan.studies.output.figure_spec import FigureSpec
from linkplan.studies.output.result import MechanismResult

if TYPE_CHECKING:
    import control


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class PlantResult(MechanismResult):
    """A plant's responses from efforts to positions at every pose; `study` has poles, zeros, curves and measurements."""

    record_name = "bode"
    study: PlantStudy

    @property
    def stable(self) -> bool:
        """Whether no pole of any response lies in the right half plane; one at zero counts as stable."""
        return not any(one.unstable_poles for point in self.study.points for one in point.responses.values())

    @property
    def poses(self) -> tuple[str, ...]:
        """The names of the analysed poses, for `lti`."""
        return tuple(point.point.name for point in self.study.points)

    def lti(self, pose: str | None = None) -> control.StateSpace:
        """Return the continuous plant at a pose as python-control's state space, with named inputs and outputs.

        The state is x = (s, s') (2 n_s,) [rad or m, and per second]; inputs are in N.m or N, outputs in rad or m. A
        dot in a name becomes an underscore: `foot_z`.

        Args:
            pose: one of `poses`; by default the first one.

        Raises:
            LinkplanError: for an unknown pose.
        """
        import control

        at = choose("pose", self.poses[0] if pose is None else str(pose), self.poses, ProblemError)
        study, point = self.study, self.study.points[self.poses.index(at)].point
        pushes = np.column_stack([effort.push(point) for effort in study.efforts])
        rows = np.stack([position.slopes(point.pose) for position in study.positions])
        matrices = plant_matrices(point, pushes, rows)
        ins, outs = ([name.replace(".", "_") for name in names] for names in (study.inputs, study.outputs))
        return control.StateSpace(*matrices, 0, inputs=ins, outputs=outs)

    def blocks(self) -> list[Block]:
        """Return the poles, zeros and gains at every pose, and the agreement with the measurement."""
        return plant_summary(self.study)

    def document(self) -> Report:
        """Return the report."""
        return plant_report(self.study)

    def figure_specs(self) -> Iterator[tuple[str, FigureSpec]]:
        """Yield plant, gain and phase of every response."""
        yield "plant", plant_figure(self.study)
