"""The sections of a feedback loop, of further studies of it, and of tuned gains."""

from collections.abc import Sequence

import numpy as np

from linkplan.studies.bode.bode import BodeStudy
from linkplan.studies.bode.bode_blocks import margins_along, nyquist, responses, sensitivities, summary
from linkplan.studies.output.document import Axis, Block, Code, Facts, Limit, Plot, Section, Series, table_of
from linkplan.studies.output.numbers import rounded
from linkplan.studies.tune.tune import Tuning
from linkplan.studies.tune.tune_report import motor_gains, tracking_table


def bode_sections(study: BodeStudy, name: str, *, depth: int = 1, verdict: bool = True) -> list[Section]:
    """Return the sections of a bode study.

    Args:
        study: with predicted responses, and measured ones if there are any.
        name: of this loop in the report, for titles and its cursor.
        depth: of the first section.
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
    return [Section(title=title, blocks=blocks, depth=depth + (k > 0)) for k, (title, blocks) in enumerate(found)]


def tune_sections(found: Tuning) -> list[Section]:
    """Return the sections of gains for requirements."""
    mechanism, wanted, settings = found.mechanism, found.wanted, found.best.settings
    joint = mechanism.independent_joints[0]
    rows = [
        ("mechanism", mechanism.name),
        ("tracker", found.law),
        ("wanted bandwidth", f"{wanted.bandwidth_hz:g} Hz at least"),
        ("wanted phase margin", f"{wanted.phase_margin_deg:g} deg at least"),
        ("control period", f"{found.timing.period_s:g} s, delay {found.timing.delay_s:g} s"),
    ]
    if np.isfinite(wanted.sensitivity_peak):
        rows.append(("wanted peak of |S|", f"{wanted.sensitivity_peak:g} at most"))
    if found.law != "lqr":
        motor, stiff = motor_gains(found), "N.m/rad" if joint.kind == "hinge" else "N/m"
        damping = "N.m.s/rad" if joint.kind == "hinge" else "N.s/m"
        rows.append(("gains at the joint", f"kp = {settings.kp:.5g} {stiff}, kd = {settings.kd:.5g} {damping}"))
        own = f"its own effort [{mechanism.actuators[0].unit}] over its own motion"
        at_motor = f"kp = {motor['kp']:.5g}, kd = {motor['kd']:.5g}, {own}"
        rows.append((f"gains at the motor, gear {motor['gear']:g}", at_motor))
    heads = ["stable", "bandwidth [Hz]", "phase margin [deg]", "gain margin [dB]", "peak of |S|"]
    cells = [
        [joint.shown(p.state[0]), m.stable, m.bandwidth_hz, m.phase_margin_deg, m.gain_margin_db, m.sensitivity_peak]
        for p, m in zip(found.points, found.best.bounds, strict=True)
    ]
    blocks: Sequence[Block] = [
        Facts(rows=rows),
        Code(title="Gains as the [tracking] table of a problem file", text=tracking_table(found)),
        table_of("At every position looked at", [(joint.name, joint.unit), *heads], cells),
        *_tuned_plots(found, joint),
    ]
    return [Section(title=f"Gains for {mechanism.name}", blocks=blocks)]


def _tuned_plots(found: Tuning, joint) -> list[Plot]:
    """Return bandwidth and phase margin over the position, with the requirements."""
    order = np.argsort([float(point.state[0]) for point in found.points])
    at = np.array([joint.shown(found.points[k].state[0]) for k in order])
    shown = []
    for name, what, unit, wanted in (
        ("bandwidth_hz", "bandwidth", "Hz", found.wanted.bandwidth_hz),
        ("phase_margin_deg", "phase margin", "deg", found.wanted.phase_margin_deg),
    ):
        bounds = [getattr(found.best.bounds[k], name) for k in order]
        values = rounded(np.array([np.nan if value is None else value for value in bounds]))
        shown.append(
            Plot(
                title=f"{what[:1].upper()}{what[1:]} over the position",
                group="along:tune",
                x_axis=Axis(label=joint.name, unit=joint.unit),
                y_axis=Axis(label=what, unit=unit),
                x=rounded(at),
                series=[
                    Series(name=what, y=values),
                    Series(name="looked at", y=values, look="points"),
                ],
                limits=[Limit(name="wanted at least", value=float(wanted))],
            )
        )
    return shown
