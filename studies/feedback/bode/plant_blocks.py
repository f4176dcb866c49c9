"""A plant from chosen inputs to chosen outputs as a document: its behaviour at rest, poles and zeros, responses."""

from collections.abc import Sequence

import numpy as np

from linkplan.controllers.trackers.names import BUILT_IN
from linkplan.studies.feedback.bode.curves import frequency_plot, measured_phase, phase_along, phase_near
from linkplan.studies.feedback.bode.plant_result import LARGEST_UNCERTAINTY, PlantCurve, PlantResponse, PlantStudy, Root
from linkplan.studies.feedback.bode.plant_words import agreement_text, modes_text, plant_notes, root_text
from linkplan.studies.output.document import Block, Facts, Plot, Report, Section, Table, Text, table_of
from linkplan.studies.output.figure_spec import FigureSpec
from linkplan.studies.output.lines import line_style
from linkplan.studies.output.numbers import drawn_rows
from linkplan.studies.output.report_file import report_of

# Points of a drawn curve, about half the width of a screen in pixels.
_DRAWN_POINTS = 300


def plant_summary(study: PlantStudy) -> list[Block]:
    """Return the verdict, the plant at every pose and the agreement with the measurement."""
    message = study.message[:1].upper() + study.message[1:]
    rows = [("mechanism", study.mechanism_name), *_measured(study)]
    notes = [*plant_notes(study.points), *study.caveats, study.contacts, study.softness, study.note]
    said = [Text(text=note, tone="note") for note in notes if note]
    return [Text(text=message), Facts(rows=rows), *_tables(study), *said]


def _measured(study: PlantStudy) -> list[tuple[str, str]]:
    """Return what held the plant while it was measured, and the agreement with the prediction."""
    if (c := study.measurement) is None:
        return []
    text = agreement_text(c, "deviation_db", "deviation_deg", study.mechanism)
    holders = dict.fromkeys(point.held_by for point in study.points if point.held_by)
    held = ", ".join("nothing: it is stable by itself" if one == "itself" else BUILT_IN[one].words for one in holders)
    return [("held by", held), ("measured responses", text)]


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


def plant_figure(study: PlantStudy) -> FigureSpec:
    """Return the figure of gain and phase of every response."""
    panels = [plot for both in plant_plots(study, "").values() for plot in both]
    how = "line: predicted" + ("; dotted: with hold and steps; dots: MuJoCo, sinestream" if study.measurement else "")
    return FigureSpec(panels=panels, title=f"{study.mechanism_name}, {study.message}; {how}", columns=2, panel_in=(6.0, 2.9))


def plant_report(study: PlantStudy) -> Report:
    """Return the report of a plant."""
    name = f"{study.mechanism_name}: {', '.join(study.inputs)} to {', '.join(study.outputs)}"
    plots = [plot for both in plant_plots(study, f"frequency:{name}").values() for plot in both]
    sections = [
        Section(title=f"Plant: {name}", blocks=plant_summary(study)[1:], depth=1),
        Section(title="Frequency response", blocks=plots, depth=2),
    ]
    return report_of(f"Plant of {study.mechanism_name}", study.message, True, sections)
