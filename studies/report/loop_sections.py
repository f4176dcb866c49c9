"""The sections of a feedback loop, of further studies of it, and of tuned gains."""

from collections.abc import Sequence

import numpy as np

from linkplan.studies.bode.bode import BodeStudy
from linkplan.studies.bode.bode_blocks import margins_along, nyquist, responses, sensitivities, summary
from linkplan.studies.output.document import Axis, Block, Code, Facts, Limit, Plot, Section, Series, table_of
from linkplan.studies.output.numbers import rounded
from linkplan.studies.tune.judged import JudgedLoop
from linkplan.studies.tune.tune import Tuning
from linkplan.studies.tune.tune_report import gain_lines, places, tracking_table, tuned_joints


def bode_sections(study: BodeStudy, name: str, *, verdict: bool = True) -> list[Section]:
    """Return the sections of a bode study.

    Args:
        study: with predicted responses, and measured ones if there are any.
        name: of this loop in the report, for titles and its cursor.
        verdict: whether the first section starts with the verdict; False if the page's header shows it.
    """
    group, joints = f"frequency:{name}", study.mechanism.independent_joints
    found: list[tuple[str, list[Block]]] = [(f"Feedback loop: {name}", summary(study, verdict=verdict))]
    for channel, joint in enumerate(joints):
        of = "" if len(joints) == 1 else f" of {joint.name}"
        entries = [entry for entry in study.points if entry.channel == channel]
        plots = [plot for both in responses(study, entries, group).values() for plot in both]
        found.append((f"Frequency response{of}", [*plots, nyquist(study, entries), *sensitivities(entries, group)]))
    for scan in study.scans:
        joint = joints[scan.channel]
        of = "" if len(joints) == 1 else f" of the loop of {joint.name}"
        found.append((f"Margins{of} over {scan.line.name}", [*margins_along(study, scan, f"{name}:{joint.name}")]))
    return [Section(title=title, blocks=blocks, depth=1 + (k > 0)) for k, (title, blocks) in enumerate(found)]


def tune_sections(found: Tuning) -> list[Section]:
    """Return the sections of gains for requirements."""
    mechanism, wanted, law, joints = found.mechanism, found.wanted, found.best.law, tuned_joints(found)
    rows = [
        ("mechanism", mechanism.name),
        ("tracker", law.name),
        ("wanted bandwidth", f"{wanted.bandwidth_hz:g} Hz at least"),
        ("wanted phase margin", f"{wanted.phase_margin_deg:g} deg at least"),
        ("control period", f"{law.timing.period_s:g} s, delay {law.timing.delay_s:g} s"),
    ]
    if np.isfinite(wanted.sensitivity_peak):
        rows.append(("wanted peak of |S|", f"{wanted.sensitivity_peak:g} at most"))
    if law.name != "lqr":
        rows += [(f"gains {where}", gains) for where, gains in gain_lines(found)]
    blocks: list[Block] = [
        Facts(rows=rows),
        Code(title="Gains as the [tracking] table of a problem file", text=tracking_table(found)),
    ]
    heads = ["stable", "bandwidth [Hz]", "phase margin [deg]", "gain margin [dB]", "peak of |S|"]
    for channel, joint in zip(mechanism.channels, joints, strict=True):
        loops = [loop for loop in found.best.loops if loop.channel == channel]
        of = "" if len(joints) == 1 else f", loop of {joint.name}"
        cells = [
            [
                *(one.shown(loop.point.state[k]) for k, one in zip(mechanism.channels, joints, strict=True)),
                loop.margins.stable,
                loop.margins.bandwidth_hz,
                loop.margins.phase_margin_deg,
                loop.margins.gain_margin_db,
                loop.margins.sensitivity_peak,
            ]
            for loop in loops
        ]
        positions = [(one.name, one.unit) for one in joints]
        blocks += [
            table_of(f"At every position looked at{of}", [*positions, *heads], cells),
            *_tuned_plots(found, loops, of),
        ]
    return [Section(title=f"Gains for {mechanism.name}", blocks=blocks)]


def _tuned_plots(found: Tuning, loops: Sequence[JudgedLoop], of: str) -> list[Plot]:
    """Return bandwidth and phase margin of one joint's loops over the position or the pose, with the requirements."""
    at, place, place_unit = places(found, loops)
    order, shown = np.argsort(at), []
    for name, what, unit, wanted in (
        ("bandwidth_hz", "bandwidth", "Hz", found.wanted.bandwidth_hz),
        ("phase_margin_deg", "phase margin", "deg", found.wanted.phase_margin_deg),
    ):
        bounds = [getattr(loops[k].margins, name) for k in order]
        values = rounded(np.array([np.nan if value is None else value for value in bounds]))
        shown.append(
            Plot(
                title=f"{what[:1].upper()}{what[1:]} over the {place if of else 'position'}{of}",
                group="along:tune",
                x_axis=Axis(label=place, unit=place_unit),
                y_axis=Axis(label=what, unit=unit),
                x=rounded(at[order]),
                series=[
                    Series(name=what, y=values),
                    Series(name="looked at", y=values, look="points"),
                ],
                limits=[Limit(name="wanted at least", value=float(wanted))],
            )
        )
    return shown
