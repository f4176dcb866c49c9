"""Further sections of a feedback loop: map of stable gains, large signals, the loop along a motion, tuned gains."""

from collections.abc import Sequence

import contourpy
import numpy as np

from linkplan.studies.bode.along_motion import AlongMotion, along_text
from linkplan.studies.bode.large_study import LargeStudy, large_text
from linkplan.studies.bode.map_study import MapStudy, agreement
from linkplan.studies.report.columns import columns
from linkplan.studies.report.document import (
    Axis,
    Block,
    Code,
    Curve,
    Facts,
    Heat,
    Limit,
    Plane,
    Plot,
    Section,
    Series,
    Table,
    Text,
)
from linkplan.studies.report.lines import TIME, Line, plots
from linkplan.studies.report.numbers import rounded, significant
from linkplan.studies.report.plan_sections import group_of
from linkplan.studies.tune.tune import Tuning
from linkplan.studies.tune.tune_report import motor_gains, tracking_table

# Smaller shares of a disturbance are drawn at this share: they are rounding errors of the simulator.
_LEAST_SHARE = 1e-12

Marked = Sequence[tuple[str, float, float]]


def map_section(study: MapStudy, marked: Marked = (), *, depth: int = 2) -> Section:
    """Return the section of a stability map; `marked` are gains (name, kp, kd), by default those of the study."""
    found = study.found
    joint = found.points[0].mechanism.independent_joints[0]
    right, tried = agreement(found)
    rows = [
        ("sampled every", f"{found.timing.period_s:g} s"),
        ("gains next to the boundary tried in MuJoCo", f"{tried}, as predicted {right}"),
    ]
    if study.longest_s is None:
        rows.append(("longest control period", f"kp = {study.kp:g}, kd = {study.kd:g} is unstable at any"))
    elif np.isfinite(study.longest_s):
        rows.append(("longest control period", f"{1e3 * study.longest_s:.4g} ms, for {study.longest_at.name}"))
    marked = marked or [("these gains", study.kp, study.kd)]
    low, high = np.nan_to_num(study.critical, nan=0.0).T
    at = np.array([joint.shown(point.state[0]) for point in found.points])
    axis = Axis(label=joint.name, unit=joint.unit)
    inertia = np.array([float(point.inertia[0, 0]) for point in found.points])
    lines = [Line(name=f"largest stable kd at kp = {study.kp:g}", values=high, unit=_damping(joint))]
    if not found.timing.delay_steps:
        lines.append(
            Line(name="2 J / T", values=2 * inertia / found.timing.period_s, unit=_damping(joint), look="dots", colour=None)
        )
    if low.max(initial=0.0) > 0:
        lines.append(Line(name="least stable kd", values=low, unit=_damping(joint)))
    lines += [
        Line(name=name, values=np.full(len(at), kd), unit=_damping(joint), look="dash", colour=1 + k)
        for k, (name, _, kd) in enumerate(marked)
    ]
    critical = plots("Stable kd over the position", "kd", axis, at, lines, group=f"along:map:{joint.name}", log=True)
    return Section(title="Stability map", blocks=[Facts(rows=rows), _gains(study, marked, joint), *critical], depth=depth)


def _damping(joint) -> str:
    return "N.m.s/rad" if joint.kind == "hinge" else "N.s/m"


def _gains(study: MapStudy, marked: Marked, joint) -> Plane:
    found = study.found
    kp, kd, radius = found.border
    curves = [
        Curve(name="predicted stability boundary, worst position", colour=4, width=2.2, **_contour(kd, kp, radius, 1.0))
    ]
    for k, level in enumerate((15.0, 30.0, 45.0, 60.0)):
        line = _contour(found.kd, found.kp, found.phase_margin_deg, level)
        if line["x"]:
            curves.append(Curve(name=f"phase margin {level:g} deg", colour=0, width=0.8 + 0.4 * k, look="dash", **line))
    if found.trials is not None:
        tried = np.array([(kp, kd) for kp, kd, _ in found.tried]).reshape(-1, 2)
        for settles, look, name in ((True, "points", "settles in MuJoCo"), (False, "cross", "does not settle")):
            which = found.trials.settles == settles
            x, y = (rounded(tried[which, column], log=True) for column in (1, 0))
            curves.append(Curve(name=name, x=x, y=y, look=look, colour=None))
    curves += [Curve(name=name, x=[kd], y=[kp], look="star", colour=1 + k) for k, (name, kp, kd) in enumerate(marked)]
    stiffness = "N.m/rad" if joint.kind == "hinge" else "N/m"
    return Plane(
        title="Stable gains over all positions",
        x_axis=Axis(label="kd", unit=_damping(joint), log=True, ends=(float(found.kd[0]), float(found.kd[-1]))),
        y_axis=Axis(label="kp", unit=stiffness, log=True, ends=(float(found.kp[0]), float(found.kp[-1]))),
        curves=curves,
        heat=Heat(
            name="least phase margin, blank where it is unstable",
            unit="deg",
            x=rounded(found.kd, log=True),
            y=rounded(found.kp, log=True),
            values=rounded(found.phase_margin_deg, digits=3),
            ends=(90.0, 0.0),
        ),
    )


def _contour(x: np.ndarray, y: np.ndarray, values: np.ndarray, level: float) -> dict:
    """Return the contour lines (x, y) of values (n_y, n_x) at a level, separated by None."""
    lines = contourpy.contour_generator(x, y, np.ma.masked_invalid(values)).lines(level)
    gap = np.array([[np.nan, np.nan]])
    rows = np.vstack([part for line in lines for part in (line, gap)]) if lines else np.empty((0, 2))
    return {"x": rounded(rows[:, 0], log=True), "y": rounded(rows[:, 1], log=True)}


def along_section(found: AlongMotion, *, depth: int = 2) -> Section:
    """Return the section of a loop frozen along a motion and, for a periodic motion, of the decay of a disturbance."""
    time = found.reference.time_s[found.instants]

    def figure(name: str) -> np.ndarray:
        return np.array([np.nan if getattr(m, name) is None else getattr(m, name) for m in found.margins], dtype=float)

    margins = [
        Line(name="phase margin", values=figure("phase_margin_deg"), unit="deg"),
        Line(name="disk phase margin", values=figure("disk_phase_margin_deg"), unit="deg"),
    ]
    blocks: list[Block] = [Text(text=along_text(found), tone="lines")]
    blocks += plots("Margins at frozen instants", "margin", TIME, time, margins, group=group_of(found.plan))
    cycle = found.floquet
    if cycle is not None:
        clear = slice(None, cycle.last_visible_sample + 1)
        decay = [
            Line(name="predicted", values=np.maximum(cycle.size[clear], _LEAST_SHARE), unit="1"),
            Line(
                name="measured in MuJoCo",
                values=np.maximum(cycle.measured_size[clear], _LEAST_SHARE),
                unit="1",
                look="dash",
            ),
        ]
        blocks += plots("Remaining share of the worst disturbance", "share", TIME, cycle.time_s[clear], decay, log=True)
    return Section(title=f"Along the motion {found.plan.problem.name}", blocks=blocks, depth=depth)


def large_section(study: LargeStudy, *, depth: int = 2) -> Section:
    """Return the section of large signals: gain at saturation, the describing function, feasible amplitudes."""
    signals, curve = study.signals, study.curve
    joint = curve.point.mechanism.independent_joints[curve.channel]
    with np.errstate(divide="ignore", invalid="ignore"):
        measured, predicted = (20 * np.log10(np.abs(x)) for x in (signals.measured, signals.predicted))
    frequency = rounded(signals.frequency_hz, log=True)
    series = []
    for k, multiple in enumerate(signals.multiples):
        name = f"command {multiple:g} of the limit"
        series.append(Series(name=f"{name}, harmonic balance", y=rounded(predicted[:, k]), colour=k % 7, width=1.1))
        series.append(Series(name=f"{name}, MuJoCo", y=rounded(measured[:, k]), colour=k % 7, look="points"))
    gain = Plot(
        title=f"Reference to position at {curve.point.name}",
        group="frequency:large",
        x_axis=Axis(label="frequency", unit="Hz", log=True),
        y_axis=Axis(label="gain", unit="dB"),
        x=frequency,
        series=series,
    )
    live = (curve.frequency_hz > 0) & np.isfinite(curve.frequency_hz)
    tried = np.isfinite(signals.saturated)
    hz = np.broadcast_to(signals.frequency_hz[:, None], signals.amplitude.shape)
    curves = [
        Curve(
            name="feasible for any controller",
            x=rounded(curve.frequency_hz[live], log=True),
            y=rounded(joint.shown(1.0) * curve.amplitude[live], log=True),
            colour=4,
            width=2.2,
        )
    ]
    for past, look, name in ((False, "cross", "this loop, not saturated"), (True, "points", "saturated")):
        which = tried & ((signals.saturated > 0) == past)
        curves.append(
            Curve(
                name=name,
                x=rounded(hz[which], log=True),
                y=rounded(joint.shown(1.0) * signals.amplitude[which], log=True),
                look=look,
                colour=None,
            )
        )
    feasible = Plane(
        title="Feasible amplitude",
        x_axis=Axis(label="frequency", unit="Hz", log=True),
        y_axis=Axis(label=f"amplitude of {joint.name}", unit=joint.unit, log=True),
        curves=curves,
    )
    return Section(title="Large signals", blocks=[Text(text=large_text(study), tone="lines"), gain, feasible], depth=depth)


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
        rows.append(("gains at the joint", f"kp = {settings.kp:.5g} {stiff}, kd = {settings.kd:.5g} {_damping(joint)}"))
        own = f"its own effort [{mechanism.actuators[0].unit}] over its own motion"
        at_motor = f"kp = {motor['kp']:.5g}, kd = {motor['kd']:.5g}, {own}"
        rows.append((f"gains at the motor, gear {motor['gear']:g}", at_motor))
    heads = columns("stable", "bandwidth [Hz]", "phase margin [deg]", "gain margin [dB]", "peak of |S|")
    points = list(zip(found.points, found.best.bounds, strict=True))
    cells = [
        [
            significant(joint.shown(p.state[0])),
            bool(m.stable),
            *(significant(x) for x in (m.bandwidth_hz, m.phase_margin_deg, m.gain_margin_db, m.sensitivity_peak)),
        ]
        for p, m in points
    ]
    blocks = [
        Facts(rows=rows),
        Code(title="Gains as the [tracking] table of a problem file", text=tracking_table(found)),
        Table(title="At every position looked at", columns=[(joint.name, joint.unit), *heads], rows=cells),
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
