"""The result of `bode` for a plant from inputs to outputs, whose fields are its record `bode.json`."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import Struct, field

from linkplan.controllers.trackers.names import BUILT_IN
from linkplan.models.errors import ProblemError, choose
from linkplan.models.mechanism import Mechanism
from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.studies.feedback.bode.curves import frequency_plot, measured_phase, phase_along, phase_near
from linkplan.studies.feedback.bode.plant_words import (
    LARGEST_UNCERTAINTY,
    PlantCurve,
    PlantPoint,
    PlantResponse,
    Root,
    agreement_text,
    modes_text,
    plant_notes,
    root_text,
)
from linkplan.studies.feedback.frequency.ports import PlantInput, PlantOutput
from linkplan.studies.feedback.frequency.transfer_function import plant_matrices
from linkplan.studies.output.document import Block, Facts, Plot, Report, Section, Table, Text, table_of
from linkplan.studies.output.figure_spec import FigureSpec
from linkplan.studies.output.lines import line_style
from linkplan.studies.output.numbers import drawn_rows
from linkplan.studies.output.report_file import report_of
from linkplan.studies.output.result import MechanismResult

if TYPE_CHECKING:
    import control

# Points of a drawn curve, about half the width of a screen in pixels.
_DRAWN_POINTS = 300


class PlantStudy(MechanismResult, Struct, frozen=True, kw_only=True, eq=False):
    """The plant from efforts to positions at several poses.

    `measurement` has the method, the largest difference between measured and predicted responses at coherent frequencies,
    and the simulator's settings; gains that had not settled do not count. `caveats` state the poses at which nothing was
    measured, or the uncertainty, with the reason.
    """

    record_name = "bode"

    mechanism_name: str = field(name="mechanism")
    message: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    points: tuple[PlantPoint, ...]
    measurement: dict[str, Any] | None
    caveats: tuple[str, ...]
    contacts: str | None
    softness: str | None
    note: str | None
    mechanism: Beside[Mechanism] = field(default=NOT_READ, name="(mechanism)")
    efforts: Beside[tuple[PlantInput, ...]] = NOT_READ
    positions: Beside[tuple[PlantOutput, ...]] = NOT_READ

    @property
    def stable(self) -> bool:
        """Whether no pole of any response lies in the right half plane; one at zero counts as stable."""
        return not any(one.unstable_poles for point in self.points for one in point.responses.values())

    @property
    def poses(self) -> tuple[str, ...]:
        """The names of the analysed poses, for `lti`."""
        return tuple(point.point.name for point in self.points)

    def lti(self, pose: str | None = None) -> "control.StateSpace":
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
        point = self.points[self.poses.index(at)].point
        pushes = np.column_stack([effort.push(point) for effort in self.efforts])
        rows = np.stack([position.slopes(point.pose) for position in self.positions])
        matrices = plant_matrices(point, pushes, rows)
        ins, outs = ([name.replace(".", "_") for name in names] for names in (self.inputs, self.outputs))
        return control.StateSpace(*matrices, 0, inputs=ins, outputs=outs)

    def blocks(self) -> list[Block]:
        """Return the verdict, the plant at every pose and the agreement with the measurement."""
        message = self.message[:1].upper() + self.message[1:]
        rows = [("mechanism", self.mechanism_name)]
        if (c := self.measurement) is not None:
            text = agreement_text(c, "deviation_db", "deviation_deg", self.mechanism)
            holders = dict.fromkeys(point.held_by for point in self.points if point.held_by)
            held = ("nothing: it is stable by itself" if one == "itself" else BUILT_IN[one].words for one in holders)
            rows += [("held by", ", ".join(held)), ("measured responses", text)]
        notes = [*plant_notes(self.points), *self.caveats, self.contacts, self.softness, self.note]
        said = [Text(text=note, tone="note") for note in notes if note]
        return [Text(text=message), Facts(rows=rows), *_tables(self), *said]

    def figure_specs(self) -> Iterator[tuple[str, FigureSpec]]:
        """Yield plant, gain and phase of every response."""
        panels = [plot for both in plant_plots(self, "").values() for plot in both]
        how = "line: predicted" + ("; dotted: with hold and steps; dots: MuJoCo, sinestream" if self.measurement else "")
        title = f"{self.mechanism_name}, {self.message}; {how}"
        yield "plant", FigureSpec(panels=panels, title=title, columns=2, panel_in=(6.0, 2.9))

    def document(self) -> Report:
        """Return the report of the plant."""
        name = f"{self.mechanism_name}: {', '.join(self.inputs)} to {', '.join(self.outputs)}"
        plots = [plot for both in plant_plots(self, f"frequency:{name}").values() for plot in both]
        sections = [
            Section(title=f"Plant: {name}", blocks=self.blocks()[1:], depth=1),
            Section(title="Frequency response", blocks=plots, depth=2),
        ]
        return report_of(f"Plant of {self.mechanism_name}", self.message, True, sections)


def _tables(study: PlantStudy) -> list[Table]:
    at_rest, swings, real = [], [], []
    for point in study.points:
        for name, one in point.responses.items():
            plant = f"{name} at {point.point.name}" if len(study.points) > 1 else name
            verdicts = [not one.unstable_poles, not one.right_half_plane_zeros]
            at_rest.append([plant, _low(one), one.unit, one.integrators, one.relative_degree, *verdicts])
            swings.append([plant, *modes_text(one.anti_resonances), *modes_text(one.resonances)])
            real.append([plant, _on_real_axis(one.zeros), _on_real_axis(one.poles)])
    heads = ["plant", "low frequencies", "unit", "integrators", "poles less zeros", "no unstable pole"]
    pairs = ["plant", "anti-resonances [Hz]", "damping", "resonances [Hz]", "damping"]
    found = [table_of("Plant at low and high frequencies", [*heads, "minimum phase"], at_rest)]
    if any(row[1] != "none" or row[3] != "none" for row in swings):
        found.append(table_of("Plant: resonances and anti-resonances", pairs, swings))
    if any(zeros != "none" or poles != "none" for _, zeros, poles in real):
        found.append(table_of("Plant: real zeros and poles", ["plant", "zeros [rad/s]", "poles [rad/s]"], real))
    return found


def _low(one: PlantResponse) -> str:
    """Return the response at low frequencies as text, such as 12.5 / s^2."""
    if not one.moves:
        return "0"
    order = one.integrators
    power = "s" if abs(order) == 1 else f"s^{abs(order)}"
    gain = f"{one.low_frequency_gain:.4g}"
    return gain if order == 0 else f"{gain} / {power}" if order > 0 else f"{gain} {power}"


def _on_real_axis(roots: Sequence[Root]) -> str:
    """Return the real roots other than zero as text."""
    return ", ".join(root_text(root) for root in roots if root.real_rad_s and not root.imaginary_rad_s) or "none"


def plant_plots(study: PlantStudy, group: str) -> dict[str, list[Plot]]:
    """Return the plots of gain and phase by response: lines predicted, dotted with hold and delay, dots measured."""
    found: dict[str, list[Plot]] = {}
    for name in study.points[0].responses:
        gain, phase = [], []
        drawn: list = []
        for k, point in enumerate(study.points):
            one, look = point.responses[name], line_style(k)
            if one.curve is None:
                continue
            label = point.point.name
            f, db, deg = _thinned(one.curve)
            deg = phase_near(f, deg, drawn)
            drawn.append((f, deg))
            gain.append((label, f, db, look))
            phase.append((label, f, deg, look))
            if one.sampled is not None:
                f, db, late = _thinned(one.sampled)
                dots = look | {"look": "dots", "width": 0.9}
                gain.append(("", f, db, dots))
                phase.append(("", f, phase_along(f, late, *drawn[-1]), dots))
            if one.measured:
                dots = {**look, "look": "points"}
                known, turned = one.measured.is_known(LARGEST_UNCERTAINTY), measured_phase(one.measured, *drawn[-1])
                at = one.measured.frequency_hz[known]
                gain.append((f"{label}, measured", at, one.measured.gain_db[known], dots))
                phase.append((f"{label}, measured", at, turned[known], dots))
        if gain:
            unit = study.points[0].responses[name].unit
            found[name] = [
                frequency_plot(f"{name}: gain", "gain", f"dB of {unit}", gain, group),
                frequency_plot(f"{name}: phase", "phase", "deg", phase, group),
            ]
    return found


def _thinned(curve: PlantCurve) -> tuple:
    """Return frequencies [Hz], gain [dB] and phase [deg] of a curve with its peaks."""
    rows = drawn_rows(np.column_stack([curve.gain_db, curve.phase_deg]), most=_DRAWN_POINTS)
    return curve.frequency_hz[rows], curve.gain_db[rows], curve.phase_deg[rows]
