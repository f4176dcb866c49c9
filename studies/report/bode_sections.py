"""The sections of a feedback loop: margins, responses predicted and measured, Nyquist curves, margins along the reach."""

from collections.abc import Sequence

import numpy as np

from linkplan.studies.bode.bode import BodePoint, BodeStudy, response_curves
from linkplan.studies.bode.bode_report import contacts_of, crossovers_of, not_measured, softness_of
from linkplan.studies.bode.curves import lowest_hz, measured_phase, sensitivity_along, shifted_phase
from linkplan.studies.bode.scan import Scan
from linkplan.studies.frequency.margins import frequency_grid
from linkplan.studies.report.columns import columns
from linkplan.studies.report.document import (
    Axis,
    Block,
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
from linkplan.studies.report.lines import Line, line_style, plots
from linkplan.studies.report.numbers import drawn_rows, rounded, significant

# Half the width of the Nyquist plane in units of |L|; the critical point is at -1.
_NYQUIST_HALF_WIDTH = 2.5
_FREQUENCY = Axis(label="frequency", unit="Hz", log=True)


def bode_sections(study: BodeStudy, name: str, *, depth: int = 1, verdict: bool = True) -> list[Section]:
    """Return the sections of a bode study.

    Args:
        study: with predicted responses, and measured ones if there are any.
        name: of this loop in the report, for titles and its cursor.
        depth: of the first section.
        verdict: whether the first section starts with the verdict; False if the page's header shows it.
    """
    group, below = f"frequency:{name}", depth + 1
    sections = [
        Section(title=f"Feedback loop: {name}", blocks=[*_verdict(study, said=verdict), _margins(study)], depth=depth)
    ]
    for channel, joint in enumerate(study.mechanism.independent_joints):
        of = "" if study.mechanism.dof == 1 else f" of {joint.name}"
        entries = [entry for entry in study.points if entry.channel == channel]
        blocks = [*_responses(study, entries, group), _nyquist(entries, study), *_sensitivities(entries, group)]
        sections.append(Section(title=f"Frequency response{of}", blocks=blocks, depth=below))
    for scan in study.scans:
        joint = study.mechanism.independent_joints[scan.channel]
        of = "" if study.mechanism.dof == 1 else f" of the loop of {joint.name}"
        blocks = [*_along_plots(scan, f"{name}:{joint.name}"), _map(study, scan)]
        sections.append(Section(title=f"Margins{of} over {scan.line.name}", blocks=blocks, depth=below))
    return sections


def _verdict(study: BodeStudy, *, said: bool) -> list[Block]:
    message = study.message[:1].upper() + study.message[1:]
    blocks: list[Block] = [Text(text=message, tone="good" if study.stable else "bad")] if said else []
    rows = [("mechanism", study.mechanism.name), ("tracker", study.law), ("feedback loop", study.loop_name)]
    deviation = study.worst_deviation
    if deviation is not None:
        c = study.conditions
        how = f"{study.method}, {study.simulated_steps} steps, MuJoCo {c['mujoco']}, {c['integrator']}"
        rows.append(("measured less predicted", f"at most {deviation[0]:.2g} dB and {deviation[1]:.2g} deg ({how})"))
    elif study.method is not None:
        rows.append(("measured", f"no: {not_measured(study).removeprefix('not measured: ')}"))
    blocks.append(Facts(rows=rows))
    sentences = (contacts_of(study), softness_of(study), *crossovers_of(study))
    notes = [Text(text=note, tone="note") for note in sentences if note]
    return [*blocks, *notes]


def _margins(study: BodeStudy) -> Table:
    mechanism = study.mechanism
    several = mechanism.dof > 1
    inertias = " or ".join(dict.fromkeys("kg m2" if j.kind == "hinge" else "kg" for j in mechanism.independent_joints))
    heads = ["pose", *(["loop of"] if several else []), f"inertia [{inertias}]", "stable", "settles in MuJoCo"]
    heads += ["largest pole", "gain margin [dB]", "phase margin [deg]", "delay margin [ms]", "disk margin", "crossover [Hz]"]
    heads += ["bandwidth [Hz]", "resonance [dB]", "peak of |S|"]
    rows = []
    for entry in study.points:
        m = entry.margins
        delay = None if m.delay_margin_s is None else 1e3 * m.delay_margin_s
        figures = [m.gain_margin_db, m.phase_margin_deg, delay, m.disk_margin]
        figures += [m.crossover_hz, m.bandwidth_hz, m.resonance_db, m.sensitivity_peak]
        of = [mechanism.independent_joints[entry.channel].name] if several else []
        inertia = float(entry.point.inertia[entry.channel, entry.channel])
        verdicts = [bool(m.stable), bool(entry.settles_in_mujoco)]
        pole = significant(m.spectral_radius, 6)
        rows.append([entry.point.name, *of, significant(inertia), *verdicts, pole, *(significant(x) for x in figures)])
    return Table(title="Margins at every pose", columns=columns(*heads), rows=rows)


def _name(entry: BodePoint) -> str:
    return entry.point.name + ("" if entry.margins.stable else " (unstable)")


def _responses(study: BodeStudy, entries: Sequence[BodePoint], group: str) -> list[Block]:
    """Return gain and phase of the open loop and of the reference to the position, and measured less predicted values."""
    reference = "reference" if study.law == "pd" else "reference+ff"
    titles = {"loop": "Open loop L", reference: f"{reference.replace('+', ' with ')} to position"}
    blocks: list[Block] = []
    for quantity, title in titles.items():
        title = title[:1].upper() + title[1:]
        ends = (-40.0, 20.0) if quantity != "loop" else None
        limit = Limit(name="crossover at", value=0.0) if quantity == "loop" else Limit(name="bandwidth at", value=-3.0)
        gain, phase, off_db, off_deg = [], [], [], []
        for k, entry in enumerate(entries):
            frequency, db, deg = _curve(entry, quantity)
            look = line_style(k)
            gain.append((_name(entry), frequency, db, look))
            phase.append((_name(entry), frequency, deg, look))
            response = entry.measured.get(quantity)
            if response is None:
                continue
            dots = {**look, "look": "points"}
            gain.append((f"{entry.point.name}, measured", response.frequency_hz, response.db, dots))
            phase.append(
                (f"{entry.point.name}, measured", response.frequency_hz, measured_phase(response, frequency, deg), dots)
            )
            less_db, less_deg = response.against(entry.predicted[quantity])
            off_db.append((entry.point.name, response.frequency_hz, less_db, look))
            off_deg.append((entry.point.name, response.frequency_hz, less_deg, look))
        limits = {"gain": [limit], "phase": [Limit(name="phase", value=-180.0)] if quantity == "loop" else []}
        blocks.append(_plot(f"{title}: gain", "gain", "dB", gain, group, limits["gain"], ends))
        blocks.append(_plot(f"{title}: phase", "phase", "deg", phase, group, limits["phase"]))
        if off_db:
            blocks.append(_plot(f"{title}: gain, measured less predicted", "difference", "dB", off_db, group))
            blocks.append(_plot(f"{title}: phase, measured less predicted", "difference", "deg", off_deg, group))
    return blocks


def _curve(entry: BodePoint, quantity: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return frequencies (n,) [Hz], gain [dB] and phase [deg] of a predicted response, thinned."""
    curve = response_curves(entry.sampled, entry.channel, [quantity])[quantity]
    shown = curve.frequency_hz >= lowest_hz(entry)
    frequency, db = curve.frequency_hz[shown], curve.db[shown]
    phase = shifted_phase(curve.phase_deg[shown], curve.gain[shown], quantity)
    rows = drawn_rows(np.column_stack([db, phase]), most=220)
    return frequency[rows], db[rows], phase[rows]


def _plot(title: str, what: str, unit: str, curves, group: str, limits: Sequence[Limit] = (), ends=None) -> Plot:
    """Return a plot over frequency of curves: name, frequencies, values, look."""
    series = [
        Series(name=name, x=rounded(frequency, log=True), y=rounded(values), **look)
        for name, frequency, values, look in curves
    ]
    lowest, highest = min(float(c[1][0]) for c in curves), max(float(c[1][-1]) for c in curves)
    return Plot(
        title=title,
        group=group,
        x_axis=_FREQUENCY,
        y_axis=Axis(label=what, unit=unit, ends=ends),
        x=rounded(np.array([lowest, highest]), log=True),
        series=series,
        limits=limits,
    )


def _sensitivities(entries: Sequence[BodePoint], group: str) -> list[Plot]:
    found = []
    for quantity, title in (
        ("sensitivity", "Sensitivity |S|"),
        ("complementary", "Complementary sensitivity |T|"),
        ("control", "Reference to effort"),
    ):
        curves, unit = [], "dB"
        for k, entry in enumerate(entries):
            frequency, db, _ = _curve(entry, quantity)
            look = line_style(k)
            curves.append((_name(entry), frequency, db, look))
            if quantity == "control":
                unit = f"dB of {entry.sampled.response(quantity, np.array([frequency[0]]), entry.channel).unit}"
            if quantity in entry.measured:
                response = entry.measured[quantity]
                dots = {**look, "look": "points"}
                curves.append((f"{entry.point.name}, measured", response.frequency_hz, response.db, dots))
        ends = None if quantity == "control" else (-50.0, 25.0)
        found.append(
            _plot(
                title,
                "gain",
                unit,
                curves,
                group,
                [] if quantity == "control" else [Limit(name="gain one,", value=0.0)],
                ends,
            )
        )
    return found


def _nyquist(entries: Sequence[BodePoint], study: BodeStudy) -> Plane:
    turn = np.exp(1j * np.linspace(0.0, 2 * np.pi, 121))
    curves = [Curve(name="unit circle", x=rounded(turn.real), y=rounded(turn.imag), look="dots", colour=None, width=1.0)]
    stable = [entry for entry in entries if entry.margins.disk_margin is not None]
    if stable:
        alpha = min(min(entry.margins.disk_margin for entry in stable), 1.999)
        disk = 1.0 / (0.5 + turn / alpha) - 1.0  # the disk that L does not enter: |S - 1/2| = 1 / alpha
        name = f"least disk margin {alpha:.3g}"
        curves.append(Curve(name=name, x=rounded(disk.real), y=rounded(disk.imag), look="area", colour=4))
    for k, entry in enumerate(entries):
        gain = entry.sampled.gains("loop", frequency_grid(study.timing.period_s)[::3], entry.channel)
        gain = np.where(np.abs(gain) < 4 * _NYQUIST_HALF_WIDTH, gain, np.nan)
        curves.append(Curve(name=_name(entry), x=rounded(gain.real), y=rounded(gain.imag), **line_style(k)))
        if "loop" in entry.measured:
            points = entry.measured["loop"].gain
            points = points[np.abs(points) < 4 * _NYQUIST_HALF_WIDTH]
            dots = {**line_style(k), "look": "points"}
            curves.append(Curve(name="", x=rounded(points.real), y=rounded(points.imag), **dots))
    curves.append(Curve(name="critical point -1", x=[-1.0], y=[0.0], look="cross", colour=None, width=2.0))
    return Plane(
        title="Nyquist curves of the open loop; dots measured"
        if any(entry.measured for entry in entries)
        else "Nyquist curves of the open loop",
        x_axis=Axis(label="real part of L", unit="1", ends=(-_NYQUIST_HALF_WIDTH, _NYQUIST_HALF_WIDTH)),
        y_axis=Axis(label="imaginary part of L", unit="1", ends=(-_NYQUIST_HALF_WIDTH, _NYQUIST_HALF_WIDTH)),
        curves=curves,
        equal=True,
    )


def _along_plots(scan: Scan, name: str) -> list[Plot]:
    """Return the margins over a line of positions; the title names the position of the worst margin."""
    line = scan.line
    x = np.array([line.shown(position) for position in scan.positions])
    axis = Axis(label=line.name if line.name != "t" else "time", unit=line.unit)
    group = f"along:{name}"
    margins = [
        Line(name="phase margin", values=scan.column("phase_margin_deg"), unit="deg"),
        Line(name="disk phase margin", values=scan.column("disk_phase_margin_deg"), unit="deg"),
    ]
    crossings = [
        Line(name="crossover", values=scan.column("crossover_hz"), unit="Hz"),
        Line(name="bandwidth", values=scan.column("bandwidth_hz"), unit="Hz"),
    ]
    title = f"Margins; the worst is at {line.place(scan.positions[scan.worst])}"
    return [
        *plots(title, "margin", axis, x, margins, group=group),
        *plots("Crossover and bandwidth", "frequency", axis, x, crossings, group=group, log=True),
    ]


def _map(study: BodeStudy, scan: Scan) -> Plane:
    """Return the map of the sensitivity over position and frequency."""
    line = scan.line
    grid, heat = sensitivity_along(study, scan, every=16)
    x = np.array([line.shown(position) for position in scan.positions])
    return Plane(
        title="Sensitivity |S| over position and frequency",
        x_axis=Axis(
            label=line.name if line.name != "t" else "time",
            unit=line.unit,
            ends=(float(x[0]), float(x[-1])) if len(x) > 1 else None,
        ),
        y_axis=Axis(label="frequency", unit="Hz", log=True, ends=(float(grid[0]), float(grid[-1]))),
        curves=[Curve(name="crossover", x=rounded(x), y=rounded(scan.column("crossover_hz"), log=True), colour=None)],
        heat=Heat(
            name="|S|, blank where it is unstable; red amplifies",
            unit="dB",
            x=rounded(x),
            y=rounded(grid, log=True),
            values=rounded(heat, digits=3),
            ends=(-12.0, 12.0),
        ),
    )
