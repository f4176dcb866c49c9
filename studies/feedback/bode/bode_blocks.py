"""The plots of a feedback loop: responses predicted and measured, Nyquist curves, margins along a line."""

from collections.abc import Sequence

import numpy as np

from linkplan.studies.feedback.bode.bode_result import BodePoint
from linkplan.studies.feedback.bode.curves import frequency_plot, measured_phase, phase_near
from linkplan.studies.feedback.bode.scan import Scan
from linkplan.studies.feedback.frequency.feedback_loops import SampledLaw, operating_point, outputs_of, plant_name
from linkplan.studies.feedback.frequency.margins import frequency_grid
from linkplan.studies.feedback.frequency.response import LEAST_COHERENCE
from linkplan.studies.output.document import (
    Axis,
    DrawnLimit,
    Heat,
    Plane,
    Plot,
    Series,
)
from linkplan.studies.output.lines import Line, line_style, plots
from linkplan.studies.output.numbers import drawn_rows, rounded

# Half the width of the Nyquist plane in units of |L| for stable loops, and the largest gain that is drawn. The critical
# point is at -1.
_NYQUIST_HALF_WIDTH, _MAX_NYQUIST_GAIN = 2.5, 30.0


def _name(entry: BodePoint) -> str:
    return entry.point.name + ("" if entry.stable else " (unstable)")


def responses(law: SampledLaw, entries: Sequence[BodePoint], group: str) -> dict[str, list[Plot]]:
    """Return the plots of the open loop, and of the reference to the position: gain, phase, measured less predicted.

    Lines are predictions of the sampled loop, dots measurements; the dotted lines are those of continuous time.
    """
    reference = "reference" if law.name == "pd" else "reference+ff"
    titles = {"loop": "Open loop L", reference: f"{reference.replace('+', ' with ')} to position"}
    found: dict[str, list[Plot]] = {}
    for quantity, title in titles.items():
        title = title[:1].upper() + title[1:]
        ends = (-40.0, 20.0) if quantity != "loop" else None
        limit = (
            DrawnLimit(name="crossover at", value=0.0) if quantity == "loop" else DrawnLimit(name="bandwidth at", value=-3.0)
        )
        gain, phase, off_db, off_deg = [], [], [], []
        drawn: list[tuple[np.ndarray, np.ndarray]] = []
        for k, entry in enumerate(entries):
            ideal, look = _curve(entry, quantity, sampled=False), line_style(k)
            frequency, db, deg = _curve(entry, quantity)
            deg = phase_near(frequency, deg, drawn)
            drawn.append((frequency, deg))
            ideal_deg = phase_near(ideal[0], ideal[2], drawn[-1:])
            beside = look | {"look": "dots", "width": 0.9}
            gain += [(_name(entry), frequency, db, look), ("", ideal[0], ideal[1], beside)]
            phase += [(_name(entry), frequency, deg, look), ("", ideal[0], ideal_deg, beside)]
            response = entry.responses.get(quantity)
            if response is None:
                continue
            dots = {**look, "look": "points"}
            gain.append((f"{entry.point.name}, measured", response.frequency_hz, response.gain_db, dots))
            phase.append(
                (f"{entry.point.name}, measured", response.frequency_hz, measured_phase(response, frequency, deg), dots)
            )
            less_db, less_deg = response.against(entry.predicted[quantity])
            for off, less in (
                (off_db, less_db),
                (off_deg, less_deg),
            ):  # a line through coherent ones, and their dots
                coherent = np.where(response.coherence > LEAST_COHERENCE, less, np.nan)
                off += [(entry.point.name, response.frequency_hz, coherent, look), ("", response.frequency_hz, less, dots)]
        limits = {"gain": [limit], "phase": [DrawnLimit(name="phase", value=-180.0)] if quantity == "loop" else []}
        found[quantity] = [
            frequency_plot(f"{title}: gain", "gain", "dB", gain, group, limits["gain"], ends),
            frequency_plot(f"{title}: phase", "phase", "deg", phase, group, limits["phase"]),
        ]
        if off_db:
            found[quantity] += [
                frequency_plot(f"{title}: gain, measured less predicted", "difference", "dB", off_db, group),
                frequency_plot(f"{title}: phase, measured less predicted", "difference", "deg", off_deg, group),
            ]
    return found


def _curve(entry: BodePoint, quantity: str, *, sampled: bool = True) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return frequencies (n,) [Hz], gain [dB] and phase [deg] of a predicted response, thinned."""
    loop = entry.sampled if sampled else entry.ideal
    curve = loop.response(quantity, frequency_grid(loop.timing.period_s)[::2], entry.channel)
    shown = curve.frequency_hz >= lowest_hz(entry)
    frequency, db = curve.frequency_hz[shown], curve.gain_db[shown]
    phase = shifted_phase(curve.phase_deg[shown], curve.gain[shown], quantity)
    rows = drawn_rows(np.column_stack([db, phase]), most=220)
    return frequency[rows], db[rows], phase[rows]


def plants(entries: Sequence[BodePoint], group: str) -> list[Plot]:
    """Return the plots of the plant from a loop's effort to its joint and to the joints that only move along."""
    found, mechanism = [], entries[0].point.mechanism
    for output in outputs_of(mechanism, entries[0].channel) if entries[0].plant else ():
        name = plant_name(mechanism, entries[0].channel, output)
        gain, phase, unit = [], [], ""
        for k, entry in enumerate(entries):
            grid, look = frequency_grid(entry.sampled.timing.period_s)[::2], line_style(k)
            curve = entry.sampled.response("plant", grid[grid >= lowest_hz(entry)], entry.channel, output)
            unit = curve.unit
            gain.append((_name(entry), curve.frequency_hz, curve.gain_db, look))
            phase.append((_name(entry), curve.frequency_hz, curve.phase_deg, look))
            if (response := entry.responses.get(name)) is not None:
                dots = {**look, "look": "points"}
                gain.append((f"{entry.point.name}, measured", response.frequency_hz, response.gain_db, dots))
                at = measured_phase(response, curve.frequency_hz, curve.phase_deg)
                phase.append((f"{entry.point.name}, measured", response.frequency_hz, at, dots))
        title = f"{entries[0].broken_at} to {mechanism.independent_joints[output].name}"
        found += [
            frequency_plot(f"{title}: gain", "gain", f"dB of {unit}", gain, group),
            frequency_plot(f"{title}: phase", "phase", "deg", phase, group),
        ]
    return found


def sensitivities(entries: Sequence[BodePoint], group: str) -> list[Plot]:
    """Return the plots of |S| with its peaks, |T| and the response of the effort."""
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
            if quantity == "sensitivity":
                peak = int(np.argmax(db))
                curves.append(("", frequency[peak : peak + 1], db[peak : peak + 1], look | {"look": "points"}))
            if quantity == "control":
                unit = f"dB of {entry.sampled.response(quantity, np.array([frequency[0]]), entry.channel).unit}"
            if quantity in entry.responses:
                response = entry.responses[quantity]
                dots = {**look, "look": "points"}
                curves.append((f"{entry.point.name}, measured", response.frequency_hz, response.gain_db, dots))
        ends = None if quantity == "control" else (-50.0, 25.0)
        limits = [] if quantity == "control" else [DrawnLimit(name="gain one at", value=0.0)]
        found.append(frequency_plot(title, "gain", unit, curves, group, limits, ends))
    return found


def nyquist(law: SampledLaw, entries: Sequence[BodePoint]) -> Plane:
    """Return the open loops in the complex plane, with the critical point and the disk of the least disk margin."""
    turn = np.exp(1j * np.linspace(0.0, 2 * np.pi, 121))
    title = f"Nyquist curves of the open loop{'; dots measured' if any(entry.responses for entry in entries) else ''}"
    curves = [Series(name="unit circle", x=rounded(turn.real), y=rounded(turn.imag), look="dots", colour=None, width=1.0)]
    stable = [(margin, k) for k, entry in enumerate(entries) if (margin := entry.disk_margin) is not None]
    if stable:
        least_margin, k = min(stable)
        alpha = min(least_margin, 1.999)
        disk = 1.0 / (0.5 + turn / alpha) - 1.0  # the disk outside of which L stays: |S - 1/2| = 1 / alpha
        least = entries[k]
        gain = least.disk_gain_margin_db or np.inf
        phase = least.disk_phase_margin_deg
        title += f"; least disk margin {alpha:.3g} at {least.point.name} (gain +-{gain:.3g} dB or phase {phase:.3g} deg)"
        curves.append(Series(name="least disk margin", x=rounded(disk.real), y=rounded(disk.imag), look="area", colour=4))
    half_width, grid = _NYQUIST_HALF_WIDTH, frequency_grid(law.timing.period_s)[::3]
    for k, entry in enumerate(entries):
        gain = entry.sampled.gains("loop", grid, entry.channel)
        # The plane has the part of every curve that is closest to the origin.
        half_width = max(half_width, 1.3 * min(float(np.abs(gain).min()), _MAX_NYQUIST_GAIN))
        gain = np.where(np.abs(gain) < _MAX_NYQUIST_GAIN, gain, np.nan)  # no straight line through a resonance
        curves.append(Series(name=_name(entry), x=rounded(gain.real), y=rounded(gain.imag), **line_style(k)))
        if "loop" in entry.responses:
            points = entry.responses["loop"].gain
            points = points[np.abs(points) < _MAX_NYQUIST_GAIN]
            dots = {**line_style(k), "look": "points"}
            curves.append(Series(name="", x=rounded(points.real), y=rounded(points.imag), **dots))
    curves.append(Series(name="critical point -1", x=[-1.0], y=[0.0], look="cross", colour=None, width=2.0))
    ends = (-half_width, half_width)
    return Plane(
        title=title,
        x_axis=Axis(label="real part of L", unit="1", ends=ends),
        y_axis=Axis(label="imaginary part of L", unit="1", ends=ends),
        curves=curves,
        equal=True,
    )


def margins_along(law: SampledLaw, entries: Sequence[BodePoint], scan: Scan, name: str) -> list[Plot | Plane]:
    """Return the sensitivity and the margins over a line of positions; the title names the position of the worst margin."""
    line = scan.line
    x = np.array([line.shown(position) for position in scan.positions])
    room = 0.02 * (x[-1] - x[0])
    ends = (float(x[0] - room), float(x[-1] + room)) if room else None  # of every panel, without values at its ends, too
    axis = Axis(label=line.name if line.name != "t" else "time", unit=line.unit, ends=ends)
    group = f"along:{name}"
    margins = [
        Line(name="phase margin", values=scan.column("phase_margin_deg"), unit="deg"),
        Line(name="disk phase margin", values=scan.column("disk_phase_margin_deg"), unit="deg"),
    ]
    known = np.concatenate([line.values for line in margins])
    highest = float(np.max(known[np.isfinite(known)], initial=0.0))  # a loop that is unstable everywhere has no margin
    lost = np.array([0.0 if not bounds.stable else np.nan for bounds in scan.margins])
    if np.isfinite(lost).any():
        margins.append(Line(name="unstable", values=lost, unit="deg", look="points", colour=4))
    crossings = [Line(name=name, values=scan.column(f"{name}_hz"), unit="Hz") for name in ("crossover", "bandwidth")]
    crossings = [one for one in crossings if np.isfinite(one.values).any()]  # none if the loop is unstable everywhere
    title = f"Margins; the worst is at {line.place(scan.positions[scan.worst])}"
    crossed = " and ".join(one.name for one in crossings).capitalize()
    return [
        _map(law, entries, scan, axis, x),
        *plots(title, "margin", axis, x, margins, group=group, ends=(0.0, max(10.0, 1.08 * highest))),
        *plots(crossed, "frequency", axis, x, crossings, group=group, log=True),
    ]


def _map(law: SampledLaw, entries: Sequence[BodePoint], scan: Scan, axis: Axis, x: np.ndarray) -> Plane:
    grid, heat = sensitivity_along(law, entries, scan)
    return Plane(
        title="Sensitivity |S| over position and frequency",
        x_axis=axis,
        y_axis=Axis(label="frequency", unit="Hz", log=True, ends=(float(grid[0]), float(grid[-1]))),
        curves=[Series(name="crossover", x=rounded(x), y=rounded(scan.column("crossover_hz"), log=True), colour=None)],
        heat=Heat(
            name="|S| (blank: unstable; red: amplifies)",
            unit="dB",
            x=rounded(x),
            y=rounded(grid, log=True),
            values=rounded(heat, digits=3),
            ends=(-12.0, 12.0),
        ),
    )


def lowest_hz(entry: BodePoint) -> float:
    """Return the lowest frequency [Hz] drawn: a fifth of the lowest measured one, or a hundredth of the crossover."""
    if entry.responses:
        return float(next(iter(entry.responses.values())).frequency_hz[0]) / 5.0
    crossing = entry.crossover_hz or entry.continuous.crossover_hz
    return (crossing or 0.05 / entry.sampled.timing.period_s) / 100.0


def shifted_phase(phase: np.ndarray, gain: np.ndarray, quantity: str) -> np.ndarray:
    """Return a phase [deg] shifted by full turns: within half a turn of -180 deg at an open loop's crossover, else of 0."""
    if quantity != "loop":
        return phase - 360.0 * np.round(phase[0] / 360.0)
    crossing = int(np.argmin(np.abs(np.log(np.abs(gain)))))
    return phase - 360.0 * np.round((phase[crossing] + 180.0) / 360.0)


def sensitivity_along(law: SampledLaw, entries: Sequence[BodePoint], scan: Scan) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies (m,) [Hz] and |S| (m, n) [dB] at a scan's n positions; NaN where the loop is unstable."""
    grid = frequency_grid(law.timing.period_s)[::16]
    grid = grid[grid >= min((lowest_hz(entry) for entry in entries), default=grid[0])]
    free = np.array([[-np.inf, np.inf]] * len(law.effort_limit))
    heat = np.full((len(grid), len(scan.positions)), np.nan)
    for column, (position, bounds) in enumerate(zip(scan.positions, scan.margins, strict=True)):
        if not bounds.stable:  # an unstable loop has no sensitivity
            continue
        loop = law.loop(operating_point(entries[0].point.mechanism, scan.line.at(position), free))
        heat[:, column] = 20 * np.log10(np.abs(loop.gains("sensitivity", grid, scan.channel)))
    return grid, heat
