"""Figure of large signals: the closed loop's gain for several amplitudes, the describing function, feasible amplitudes."""

from pathlib import Path

import numpy as np

from linkplan.studies.bode.large_study import LargeStudy
from linkplan.studies.output.drawing import BLACK, GREY, ORANGE, RED, SERIES, outside_legend, page


def large_figure(study: LargeStudy, path: Path) -> None:
    """Draw the three plots side by side."""
    with page(path, rows=1, columns=3, size=(14.5, 4.8)) as axes:
        draw_large_gain(axes[0, 0], study)
        draw_describing(axes[0, 1], study)
        draw_feasible(axes[0, 2], study)
        figure = axes[0, 0].figure
        figure.suptitle(
            f"{study.curve.point.mechanism.name} at {study.curve.point.name}: beyond the effort limit", fontsize=10.5
        )


def draw_large_gain(axes, study: LargeStudy) -> None:
    """Draw the reference response's gain for every amplitude: dots are measured, lines are harmonic balance."""
    signals = study.signals
    for j, (colour, multiple) in enumerate(zip(SERIES * 2, signals.multiples, strict=False)):
        axes.semilogx(signals.frequency_hz, 20 * np.log10(np.abs(signals.predicted[:, j])), color=colour, linewidth=1.1)
        axes.semilogx(
            signals.frequency_hz,
            20 * np.log10(np.abs(signals.measured[:, j])),
            "o",
            color=colour,
            markersize=4,
            label=f"{multiple:g}",
        )
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel("reference to angle [dB]")
    axes.set_title("commanded effort over its limit; dots MuJoCo, lines harmonic balance", fontsize=9, pad=24)
    outside_legend(axes, fontsize=8, handletextpad=0.1, columnspacing=0.9)


def draw_describing(axes, study: LargeStudy) -> None:
    """Draw applied over commanded effort as a function of the command, with python-control's describing function."""
    signals = study.signals
    ratio = signals.command / signals.room
    known = np.isfinite(ratio)
    order = np.argsort(ratio[known])
    axes.loglog(
        ratio[known][order], signals.describing_predicted[known][order], color=BLACK, linewidth=1.2, label="saturation's"
    )
    axes.loglog(ratio[known], np.abs(signals.describing[known]), "o", color=ORANGE, markersize=4, label="MuJoCo")
    axes.set_xlabel("commanded effort over its limit")
    axes.set_ylabel("applied over commanded effort")
    axes.set_title("describing function")
    axes.legend(loc="lower left")


def draw_feasible(axes, study: LargeStudy) -> None:
    """Draw the feasible-amplitude curve over frequency and the measured points: hollow if unsaturated, full if saturated."""
    curve, signals = study.curve, study.signals
    joint = curve.point.mechanism.independent_joints[curve.channel]
    shown = joint.shown(1.0)
    live = (curve.frequency_hz > 0) & np.isfinite(curve.frequency_hz)
    axes.loglog(
        curve.frequency_hz[live],
        shown * curve.amplitude[live],
        color=RED,
        linewidth=1.8,
        label="feasible for any controller",
    )
    tried = np.isfinite(signals.saturated)
    frequency = np.broadcast_to(signals.frequency_hz[:, None], signals.amplitude.shape)
    for past, fill, label in ((False, "none", "this loop, not saturated"), (True, "full", "saturated")):
        which = tried & ((signals.saturated > 0) == past)
        axes.loglog(
            frequency[which], shown * signals.amplitude[which], "o", color=GREY, fillstyle=fill, markersize=4, label=label
        )
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel(f"amplitude of {joint.name} [{joint.unit}]")
    axes.set_title("feasible amplitude")
    axes.legend(loc="lower left", fontsize=8)
