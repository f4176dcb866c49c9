"""Further studies of a feedback loop as documents: the map of stable gains, large signals, the loop along a motion."""

from collections.abc import Sequence

import contourpy
import numpy as np

from linkplan.controllers.trackers.names import BUILT_IN
from linkplan.studies.feedback.bode.bode_result import TRIAL_GAIN_SHARE, AlongMotion, MapStudy
from linkplan.studies.feedback.bode.scan import bounds_text, figures
from linkplan.studies.feedback.frequency.describing import LargeSignals
from linkplan.studies.feedback.frequency.floquet import floquet_text
from linkplan.studies.output.document import MEASURED, Axis, Block, Facts, Heat, Plane, Plot, Series, Text, table_of
from linkplan.studies.output.lines import TIME, Line, plots
from linkplan.studies.output.numbers import rounded
from linkplan.studies.output.plan_blocks import radius_figure

# Smaller shares of a disturbance are drawn at this share: they are rounding errors of the simulator.
_LEAST_SHARE = 1e-12

Marked = Sequence[tuple[str, float, float]]


def map_blocks(study: MapStudy, marked: Marked = ()) -> list[Block]:
    """Return a stability map; `marked` are gains (name, kp, kd), by default those of the study."""
    joint = study.points[0].mechanism.independent_joints[0]
    stiffness, damping = joint.gain_units
    own_kp, own_kd = study.gains
    delay = f", delay {study.timing.delay_s:g} s" if study.timing.delay_steps else ""
    rows = [
        ("sampled every", f"{study.timing.period_s:g} s{delay}"),
        ("gains next to the stability boundary tried in MuJoCo", f"{study.tried_count}, as predicted {study.as_predicted}"),
    ]
    gains = f"kp = {own_kp:g} {stiffness}, kd = {own_kd:g} {damping}"
    longest_s = study.longest_period_s
    if longest_s is None:
        rows.append(("longest control period", f"{gains} is unstable at any"))
    elif np.isfinite(longest_s):
        period = f"{1e3 * longest_s:.4g} ms ({1e-3 / longest_s:.4g} kHz)"
        rows.append(("longest control period", f"{period} for {gains}, at {study.longest_at.name}"))
    marked = marked or [("these gains", own_kp, own_kd)]
    low, high = np.nan_to_num(study.critical, nan=0.0).T
    at = np.array([joint.shown(point.state[0]) for point in study.points])
    axis = Axis(label=joint.name, unit=joint.unit)
    inertia = np.array([float(point.inertia[0, 0]) for point in study.points])
    heads = [f"inertia [{joint.inertia_unit}]", f"least kd [{damping}]", f"largest kd [{damping}]"]
    stable = zip(at, inertia, *study.critical.T, strict=True)
    table = table_of(f"Stable kd at kp = {own_kp:g} {stiffness}", [(joint.name, joint.unit), *heads], list(stable))
    lines = [Line(name=f"largest stable kd at kp = {own_kp:g}", values=high, unit=damping, colour=4)]
    if not study.timing.delay_steps:
        lines.append(
            Line(name="2 J / T", values=2 * inertia / study.timing.period_s, unit=damping, look="dots", colour=None)
        )
    if low.max(initial=0.0) > 0:
        lines.append(Line(name="least stable kd", values=low, unit=damping))
    lines += [
        Line(name=name, values=np.full(len(at), kd), unit=damping, look="dash", colour=1 + k)
        for k, (name, _, kd) in enumerate(marked)
    ]
    for settles, look, name in ((True, "points", "settles in MuJoCo"), (False, "cross", "does not settle")):
        for column, share in enumerate((1 - TRIAL_GAIN_SHARE, 1 + TRIAL_GAIN_SHARE)):
            tried_kd = np.where(study.settles_near_border[:, column] == settles, share * high, np.nan)
            if np.isfinite(tried_kd).any():
                name = "" if any(line.name == name for line in lines) else name
                lines.append(Line(name=name, values=tried_kd, unit=damping, look=look, colour=None))
    critical = plots("Stable kd over the position", "kd", axis, at, lines, group=f"along:map:{joint.name}", log=True)
    return [Facts(rows=rows), table, _gains(study, marked, stiffness, damping), *critical]


def _gains(study: MapStudy, marked: Marked, stiffness: str, damping: str) -> Plane:
    kp, kd, radius = study.border
    curves = [Series(name="predicted stability boundary", colour=4, width=2.2, **_contour(kd, kp, radius, 1.0))]
    for k, level in enumerate((15.0, 30.0, 45.0, 60.0)):
        line = _contour(study.kd, study.kp, study.phase_margin_deg, level)
        if line["x"]:
            curves.append(Series(name=f"phase margin {level:g} deg", colour=0, width=0.8 + 0.4 * k, look="dash", **line))
    for settles, look, name in ((True, "points", "settles in MuJoCo"), (False, "cross", "does not settle")):
        tried = [one for one in study.tried if one.settles_in_mujoco == settles]
        if tried:
            x, y = rounded(np.array([(one.kd, one.kp) for one in tried]).T, log=True)
            curves.append(Series(name=name, x=x, y=y, look=look, colour=None))
    curves += [Series(name=name, x=[kd], y=[kp], look="star", colour=1 + k) for k, (name, kp, kd) in enumerate(marked)]
    return Plane(
        title="Stable gains over all positions",
        x_axis=Axis(label="kd", unit=damping, log=True, ends=(float(study.kd[0]), float(study.kd[-1]))),
        y_axis=Axis(label="kp", unit=stiffness, log=True, ends=(float(study.kp[0]), float(study.kp[-1]))),
        curves=curves,
        heat=Heat(
            name="least phase margin (blank: unstable)",
            unit="deg",
            x=rounded(study.kd, log=True),
            y=rounded(study.kp, log=True),
            values=rounded(study.phase_margin_deg, digits=3),
            ends=(90.0, 0.0),
        ),
    )


def _contour(x: np.ndarray, y: np.ndarray, values: np.ndarray, level: float) -> dict:
    """Return the contour lines (x, y) of values (n_y, n_x) at a level, separated by None."""
    lines = contourpy.contour_generator(x, y, np.ma.masked_invalid(values)).lines(level)
    gap = np.array([[np.nan, np.nan]])
    rows = np.vstack([part for line in lines for part in (np.asarray(line), gap)]) if lines else np.empty((0, 2))
    return {"x": rounded(rows[:, 0], log=True), "y": rounded(rows[:, 1], log=True)}


def along_blocks(found: AlongMotion) -> list[Block]:
    """Return a loop frozen along a motion and, for a periodic motion, the decay of a disturbance."""
    worst = found.worst
    said = bounds_text(worst) + (f", of the loop of {worst.joint}" if found.n_loops > 1 else "")
    frozen = (
        f"{BUILT_IN[found.tracker].words} at frozen instants along {found.plan}: worst at {1e3 * worst.time_s:.4g} ms"
        f" ({said}); the largest frozen pole is {radius_figure(found.largest_frozen_pole)}"
    )
    cycle = found.floquet
    none = "the motion is not periodic: there are no Floquet multipliers"
    blocks: list[Block] = [Text(text=frozen), Text(text=none if cycle is None else floquet_text(cycle))]
    margins = [
        Line(name="phase margin", values=figures(found.frozen, "phase_margin_deg"), unit="deg"),
        Line(name="disk phase margin", values=figures(found.frozen, "disk_phase_margin_deg"), unit="deg"),
    ]
    several = ", the worst coordinate's loop" if found.n_loops > 1 else ""
    title = f"Margins at frozen instants{several}"
    blocks += plots(title, "margin", TIME, figures(found.frozen, "time_s"), margins, group=f"time:{found.plan}")
    if cycle is not None:
        shares = [np.maximum(size, _LEAST_SHARE) for size in (cycle.size, cycle.measured_size)]
        decay = [
            Line(name="predicted", values=shares[0], unit="1"),
            Line(name="measured in MuJoCo", values=shares[1], unit="1", look="dash"),
        ]
        title = f"Decay of the worst disturbance: it is multiplied by at most {cycle.multiplier_size[0]:.3g} per cycle"
        blocks += plots(title, "share", TIME, cycle.time_s, decay, log=True)
    return blocks


def large_blocks(signals: LargeSignals) -> list[Block]:
    """Return large signals: gain at saturation, the describing function, feasible amplitudes."""
    curve = signals.curve
    joint = curve.point.mechanism.independent_joints[0]
    texts: list[Block] = [Text(text=f"large signals at {curve.point.name}")]
    cut = signals.saturated > 0.05
    if np.any(cut):
        deviation = np.abs(signals.describing[cut] / signals.describing_predicted[cut] - 1).max()
        off = np.abs(signals.gain_db[cut] - signals.predicted_db[cut]).max()
        said = (
            f"beyond the effort limit, {int(cut.sum())} measured points differ by at most {100 * deviation:.2g} % from the"
            f" describing function of a saturation, and the closed loop by at most {off:.2g} dB from harmonic balance"
        )
        texts.append(Text(text=said))
    places = list(zip(curve.amplitude, curve.frequency_hz, curve.reason, strict=True))
    followed = [
        [joint.shown(a), f if f > 0 else "at no frequency", reason] for a, f, reason in places[:: max(1, len(places) // 6)]
    ]
    heads = [f"amplitude [{joint.unit}]", "can be followed up to [Hz]", "because of"]
    texts.append(table_of("Feasible amplitudes", heads, followed))
    frequency = rounded(signals.frequency_hz, log=True)
    series = []
    for k, multiple in enumerate(signals.multiples):
        name = f"command {multiple:g} of the limit"
        series.append(Series(name=name, y=rounded(signals.predicted_db[:, k]), colour=k % 7, width=1.1))
        series.append(Series(name=name + MEASURED, y=rounded(signals.gain_db[:, k]), colour=k % 7, look="points"))
    gain = Plot(
        title=f"Reference to position at {curve.point.name}, lines by harmonic balance",
        group="frequency:large",
        x_axis=Axis(label="frequency", unit="Hz", log=True),
        y_axis=Axis(label="gain", unit="dB"),
        x=frequency,
        series=series,
    )
    ratio, known = signals.command / signals.room, np.isfinite(signals.command / signals.room)
    order = np.argsort(ratio[known])
    x = rounded(ratio[known][order], log=True)
    described = (
        ("saturation's", signals.describing_predicted, "line", None),
        ("MuJoCo", signals.describing, "points", 1),
    )
    describing = Plane(
        title="Describing function",
        x_axis=Axis(label="commanded effort over its limit", unit="1", log=True),
        y_axis=Axis(label="applied over commanded effort", unit="1", log=True),
        curves=[
            Series(name=name, x=x, y=rounded(values[known][order], log=True), look=look, colour=colour)
            for name, values, look, colour in described
        ],
    )
    live = (curve.frequency_hz > 0) & np.isfinite(curve.frequency_hz)
    tried = np.isfinite(signals.saturated)
    amplitude = signals.amplitude_deg if joint.unit == "deg" else signals.amplitude_m
    hz = np.broadcast_to(signals.frequency_hz[:, None], amplitude.shape)
    curves = [
        Series(
            name="feasible for any controller",
            x=rounded(curve.frequency_hz[live], log=True),
            y=rounded(joint.shown(curve.amplitude[live]), log=True),
            colour=4,
            width=2.2,
        )
    ]
    for past, look, name in ((False, "cross", "this loop, not saturated"), (True, "points", "saturated")):
        which = tried & ((signals.saturated > 0) == past)
        curves.append(
            Series(
                name=name,
                x=rounded(hz[which], log=True),
                y=rounded(amplitude[which], log=True),
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
    return [*texts, gain, describing, feasible]
