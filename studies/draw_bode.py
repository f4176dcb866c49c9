"""Figures of a loop's frequency response."""

from pathlib import Path

import numpy as np

from studies.bode import BodeStudy
from studies.drawing import GREY, SERIES, page


def bode_figure(study: BodeStudy, path: Path) -> None:
    """Draw the open loop's gain and phase, the closed loop and the sensitivity, sampled and continuous, at every pose."""
    with page(path, rows=2, columns=2, size=(10.5, 7.0), sharex=True) as axes:
        draw_gain(axes[0, 0], study, "open", "open loop |L| [dB]")
        draw_phase(axes[1, 0], study)
        draw_gain(axes[0, 1], study, "closed", "closed loop |T| [dB]")
        draw_gain(axes[1, 1], study, "sensitivity", "sensitivity |S| [dB]")
        axes[0, 0].axhline(0.0, color=GREY, linewidth=1.0)
        axes[1, 0].axhline(-180.0, color=GREY, linewidth=1.0)
        axes[0, 1].axhline(-3.0, color=GREY, linewidth=1.0, linestyle=":")
        axes[0, 1].set_ylim(-40, 30)
        axes[1, 1].set_ylim(-60, 30)
        for cell in axes[1]:
            cell.set_xlabel("frequency [Hz]")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        figure = axes[0, 0].figure
        figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
        title = f"{study.mechanism.name}: {study.message}\nsolid: sampled, dotted: continuous"
        figure.suptitle(title, fontsize=10.5, wrap=True)


def draw_gain(axes, study: BodeStudy, which: str, label: str) -> None:
    """Draw one gain in dB at every pose: sampled solid, continuous dotted."""
    joint, index = study.mechanism.independent_joints[0], study.mechanism.independent[0]
    for colour, point in zip(SERIES * len(study.points), study.points, strict=False):
        predicted = point.predicted
        name = f"{joint.name} = {joint.shown(predicted.pose[index]):.4g} {joint.unit}"
        name += "" if predicted.sampled.margins.stable else " (unstable)"
        sampled = predicted.sampled
        shown = sampled.frequency_hz >= 1.0
        axes.semilogx(
            sampled.frequency_hz[shown], _db(getattr(sampled, which)[shown]), color=colour, label=name, linewidth=1.3
        )
        axes.semilogx(
            sampled.frequency_hz[shown],
            _db(getattr(predicted.continuous, which)[shown]),
            color=colour,
            linestyle=":",
            linewidth=0.9,
        )
    axes.set_ylabel(label)


def draw_phase(axes, study: BodeStudy) -> None:
    """Draw the open loop's phase in degrees at every pose: sampled solid, continuous dotted."""
    for colour, point in zip(SERIES * len(study.points), study.points, strict=False):
        for response, style, width in ((point.predicted.sampled, "-", 1.3), (point.predicted.continuous, ":", 0.9)):
            phase = np.degrees(np.unwrap(np.angle(response.open)))
            # Whole turns are free: show the phase within a turn of -180 deg where the gain crosses one.
            crossing = int(np.argmin(np.abs(np.log(np.abs(response.open)))))
            phase -= 360.0 * np.round((phase[crossing] + 180.0) / 360.0)
            shown = response.frequency_hz >= 1.0
            axes.semilogx(response.frequency_hz[shown], phase[shown], color=colour, linestyle=style, linewidth=width)
    axes.set_ylabel("open loop phase [deg]")


def _db(gain: np.ndarray) -> np.ndarray:
    return 20 * np.log10(np.maximum(np.abs(gain), 1e-12))
