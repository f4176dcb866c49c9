"""Figures of loops' frequency responses: prediction and measurement in one plot, with their difference below."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from linkplan.studies.bode.bode import BodePoint, BodeStudy, response_curves
from linkplan.studies.bode.curves import lowest_hz, measured_phase, sensitivity_along, shifted_phase
from linkplan.studies.bode.scan import Scan
from linkplan.studies.frequency.margins import frequency_grid
from linkplan.studies.frequency.response import Response
from linkplan.studies.output.drawing import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    RED,
    SERIES,
    STYLES,
    bottom_legend,
    outside_legend,
    page,
    wrapped,
)

# Nyquist curves are not drawn beyond this gain.
_MAX_NYQUIST_GAIN = 30.0


def save_bode(study: BodeStudy, place: Path) -> None:
    """Draw every figure of a study into a folder: bode.png, nyquist.png, sensitivity.png and margins.png."""
    for channel, joint in enumerate(study.mechanism.independent_joints):
        suffix = "" if study.mechanism.dof == 1 else f"-{joint.name}"
        entries = [entry for entry in study.points if entry.channel == channel]
        bode_figure(study, entries, place / f"bode{suffix}.png")
        nyquist_figure(study, entries, place / f"nyquist{suffix}.png")
        sensitivity_figure(study, entries, place / f"sensitivity{suffix}.png")
    for scan in study.scans:
        suffix = "" if study.mechanism.dof == 1 else f"-{study.mechanism.independent_joints[scan.channel].name}"
        margin_figure(study, scan, place / f"margins{suffix}.png")


def bode_figure(study: BodeStudy, entries: Sequence[BodePoint], path: Path | None = None) -> Figure:
    """Return the figure of open and closed loop at every pose, saved at `path` if given.

    Predictions are lines, measurements are dots, and the lower plots show the differences.
    """
    reference = "reference" if study.law == "pd" else "reference+ff"
    titles = {"loop": "open loop L", reference: f"{reference.replace('+', ' with ')} to angle"}
    measured = any(entry.measured for entry in entries)
    rows = 4 if measured else 2
    ratios = {"height_ratios": [2, 1.6, 1, 1][:rows]}
    with page(path, rows=rows, columns=2, size=(11.0, 9.0 if measured else 6.5), sharex=True, gridspec_kw=ratios) as axes:
        for column, (quantity, title) in enumerate(titles.items()):
            axes[0, column].set_title(title)
            for (colour, style), entry in zip(_looks(entries), entries, strict=True):
                draw_response(axes[:2, column], entry, quantity, colour, style)
                if measured:
                    draw_difference(axes[2:, column], entry, quantity, colour)
            axes[-1, column].set_xlabel("frequency [Hz]")
            axes[0, column].axhline(0.0 if column == 0 else -3.0, color=GREY, linewidth=1.0, linestyle=":")
        axes[1, 0].axhline(-180.0, color=GREY, linewidth=1.0, linestyle=":")
        axes[0, 1].set_ylim(-40, 20)
        for row, label in enumerate(
            ["gain [dB]", "phase [deg]", "measured less\npredicted [dB]", "measured less\npredicted [deg]"][:rows]
        ):
            axes[row, 0].set_ylabel(label)
        figure = axes[0, 0].figure
        bottom_legend(axes[0, 0])
        how = "line: predicted, sampled; dotted: continuous" + (f"; dots: MuJoCo, {study.method}" if measured else "")
        title = wrapped(f"{study.mechanism.name}, {study.law}: {study.message}", 110)
        figure.suptitle(f"{title}\n{how}", fontsize=10.5)
    return figure


def draw_response(axes, entry: BodePoint, quantity: str, colour: str, style: str = "-") -> None:
    """Draw gain (axes[0]) and phase (axes[1]) of a quantity at a pose."""
    name = _name(entry)
    lowest = lowest_hz(entry)
    phases = {}
    for loop, look, width in ((entry.sampled, style, 1.3), (entry.continuous, ":", 0.9)):
        curve = response_curves(loop, entry.channel, [quantity])[quantity]
        shown = curve.frequency_hz >= lowest
        frequency, phase = curve.frequency_hz[shown], shifted_phase(curve.phase_deg[shown], curve.gain[shown], quantity)
        label = name if loop is entry.sampled else None
        axes[0].semilogx(frequency, curve.db[shown], color=colour, linestyle=look, linewidth=width, label=label)
        axes[1].semilogx(frequency, phase, color=colour, linestyle=look, linewidth=width)
        phases[look] = frequency, phase
    if quantity in entry.measured:
        response = entry.measured[quantity]
        phase = measured_phase(response, *phases[style])
        axes[0].semilogx(response.frequency_hz, response.db, "o", color=colour, markersize=3.5)
        axes[1].semilogx(response.frequency_hz, phase, "o", color=colour, markersize=3.5)


def _looks(entries: Sequence[BodePoint]) -> list[tuple[str, str]]:
    """Return a colour and a line style for each pose; the style changes when the colours repeat."""
    return [(SERIES[k % len(SERIES)], STYLES[k // len(SERIES) % len(STYLES)]) for k in range(len(entries))]


def _name(entry: BodePoint) -> str:
    return entry.point.name + ("" if entry.margins.stable else " (unstable)")


def draw_difference(axes, entry: BodePoint, quantity: str, colour: str) -> None:
    """Draw measured minus predicted in dB (axes[0]) and degrees (axes[1]); marks are open if the coherence is below 0.99."""
    if quantity not in entry.measured:
        return
    response = entry.measured[quantity]
    for cell, values in zip(axes, response.against(entry.predicted[quantity]), strict=True):
        good = response.coherence > 0.99
        cell.semilogx(response.frequency_hz[good], values[good], "o-", color=colour, markersize=3.0, linewidth=0.8)
        cell.semilogx(response.frequency_hz[~good], values[~good], "o", color=colour, markersize=3.0, fillstyle="none")


def nyquist_figure(study: BodeStudy, entries: Sequence[BodePoint], path: Path) -> None:
    """Draw the open loop in the complex plane, with the critical point, the unit circle and the smallest disk margin."""
    with page(path, size=(6.4, 6.4)) as axes:
        cell = axes[0, 0]
        turn = np.exp(1j * np.linspace(0, 2 * np.pi, 361))
        cell.plot(turn.real, turn.imag, color=GREY, linestyle=":", linewidth=1.0)
        cell.plot([-1], [0], "+", color=BLACK, markersize=11, markeredgewidth=2)
        side = 2.5
        for (colour, style), entry in zip(_looks(entries), entries, strict=True):
            gain = entry.sampled.gains("loop", frequency_grid(study.timing.period_s), entry.channel)
            # The plot shows the part of every curve that is closest to the origin.
            side = max(side, 1.3 * min(float(np.abs(gain).min()), _MAX_NYQUIST_GAIN))
            gain = np.where(np.abs(gain) < _MAX_NYQUIST_GAIN, gain, np.nan)  # no straight line across a resonance
            cell.plot(gain.real, gain.imag, color=colour, linestyle=style, linewidth=1.2, label=_name(entry))
            if "loop" in entry.measured:
                points = entry.measured["loop"].gain
                cell.plot(points.real, points.imag, "o", color=colour, markersize=3.5)
        known = [entry for entry in entries if entry.margins.disk_margin is not None]
        dots = "; dots: MuJoCo" if any("loop" in entry.measured for entry in entries) else ""
        if not known:
            cell.set_title(f"{study.mechanism.name}, {study.law}: unstable, no disk margin{dots}", fontsize=10)
        else:
            least = min(known, key=lambda entry: entry.margins.disk_margin)
            alpha = least.margins.disk_margin
            disk = _disk(alpha, turn)
            cell.fill(disk.real, disk.imag, color=GREY, alpha=0.2, linewidth=0)
            bounds = least.margins
            cell.set_title(
                f"{study.mechanism.name}, {study.law}: least disk margin {alpha:.3g} at {least.point.name}\n"
                f"(gain +-{bounds.disk_gain_margin_db or np.inf:.3g} dB or phase {bounds.disk_phase_margin_deg:.3g} deg)"
                f"{dots}",
                fontsize=10,
            )
        cell.set_xlim(-side, side)
        cell.set_ylim(-side, side)
        cell.set_aspect("equal")
        cell.set_xlabel("real part of L")
        cell.set_ylabel("imaginary part of L")
        bottom_legend(cell)


def _disk(alpha: float, turn: np.ndarray) -> np.ndarray:
    """Return the boundary |S - 1/2| = 1 / alpha, S = 1 / (1 + L), of the disk that L avoids."""
    if alpha >= 2:
        alpha = 1.999
    return 1.0 / (0.5 + turn / alpha) - 1.0


def sensitivity_figure(study: BodeStudy, entries: Sequence[BodePoint], path: Path) -> None:
    """Draw sensitivity and complementary sensitivity with their peaks, and the control sensitivity."""
    titles = {"sensitivity": "|S| [dB]", "complementary": "|T| [dB]", "control": "reference to effort"}
    with page(path, rows=1, columns=3, size=(13.0, 4.3), sharex=True) as axes:
        for cell, (quantity, label) in zip(axes[0], titles.items(), strict=True):
            unit = ""
            for (colour, style), entry in zip(_looks(entries), entries, strict=True):
                curve = response_curves(entry.sampled, entry.channel, [quantity])[quantity]
                unit = curve.unit
                shown = curve.frequency_hz >= lowest_hz(entry)
                look = {"color": colour, "linestyle": style, "linewidth": 1.3, "label": _name(entry)}
                cell.semilogx(curve.frequency_hz[shown], curve.db[shown], **look)
                _mark_peak(cell, curve, quantity, colour)
                if quantity in entry.measured:
                    response = entry.measured[quantity]
                    cell.semilogx(response.frequency_hz, response.db, "o", color=colour, markersize=3.5)
            cell.set_ylabel(label if quantity != "control" else f"{label} [dB of {unit}]")
            cell.set_xlabel("frequency [Hz]")
            cell.axhline(0.0, color=GREY, linewidth=1.0, linestyle=":")
            if quantity != "control":
                cell.set_ylim(-50, 25)
        axes[0, 0].set_title("sensitivity, peaks marked")
        axes[0, 1].set_title("complementary sensitivity")
        axes[0, 2].set_title("control sensitivity")
        axes[0, 2].set_ylim(bottom=axes[0, 2].get_ylim()[1] - 80)
        bottom_legend(axes[0, 0])
        how = "lines predicted, dots MuJoCo" if any(entry.measured for entry in entries) else "predicted"
        axes[0, 0].figure.suptitle(f"{study.mechanism.name}, {study.law}: {study.loop_name}; {how}", fontsize=10.5)


def _mark_peak(cell, curve: Response, quantity: str, colour: str) -> None:
    if quantity == "sensitivity":
        k = int(np.argmax(curve.db))
        cell.plot([curve.frequency_hz[k]], [curve.db[k]], "v", color=colour, markersize=6)


def margin_figure(study: BodeStudy, scan: Scan, path: Path) -> None:
    """Draw the sensitivity over position and frequency as a heat map, and the margins over position."""
    joint, line = study.mechanism.independent_joints[scan.channel], scan.line
    positions = np.array([line.shown(x) for x in scan.positions])
    grid, heat = sensitivity_along(study, scan)
    with page(path, rows=2, columns=1, size=(8.0, 7.2), sharex=True) as axes:
        upper, lower = axes[:, 0]
        image = upper.pcolormesh(positions, grid, heat, shading="nearest", cmap="RdBu_r", vmin=-12, vmax=12)
        upper.set_yscale("log")
        upper.set_ylabel("frequency [Hz]")
        upper.set_ylim(grid[0], grid[-1])
        upper.figure.colorbar(image, ax=upper, label="|S| [dB]: red amplifies")
        crossover = scan.column("crossover_hz")
        if np.any(np.isfinite(crossover)):
            upper.plot(positions, crossover, color=BLACK, linewidth=1.2, label="crossover")
            outside_legend(upper)
        highest = 0.0
        for name, label, colour in (
            ("phase_margin_deg", "phase margin", BLUE),
            ("disk_phase_margin_deg", "disk phase margin", ORANGE),
        ):
            values = scan.column(name)
            highest = max(highest, float(np.max(values[np.isfinite(values)], initial=0.0)))
            lower.plot(positions, values, color=colour, label=label)
        worst = scan.worst
        lower.axvline(
            positions[worst], color=RED, linestyle="--", linewidth=1.0, label=f"worst: {positions[worst]:.4g} {line.unit}"
        )
        lost = positions[[not bounds.stable for bounds in scan.margins]]
        if lost.size:
            lower.plot(lost, np.zeros(lost.size), "x", color=RED, label="unstable", clip_on=False)
        lower.set_ylim(0.0, max(10.0, 1.08 * highest))
        lower.set_ylabel("margin [deg]")
        lower.set_xlabel(f"{line.name} [{line.unit}]")
        outside_legend(lower)
        of = "" if study.mechanism.dof == 1 else f", loop of {joint.name}"
        upper.figure.suptitle(f"{study.mechanism.name}, {study.law}{of}: {study.loop_name}")
