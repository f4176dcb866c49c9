"""Figure of tuned gains: bandwidth, phase margin and sensitivity peak at every pose, with their required values."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from linkplan.studies.output.figure import BLUE, GREY, RED, outside_legend, page
from linkplan.studies.tune.judged import JudgedLoop
from linkplan.studies.tune.tune import Tuning
from linkplan.studies.tune.tune_report import places, tuned_joints


def tune_figure(tuning: Tuning, path: Path | None = None) -> Figure:
    """Return the figure of every joint's margins over the poses, with unstable poses marked, saved at `path` if given."""
    joints, wanted = tuned_joints(tuning), tuning.wanted
    rows = [
        ("bandwidth_hz", "bandwidth [Hz]", wanted.bandwidth_hz, "wanted at least"),
        ("phase_margin_deg", "phase margin [deg]", wanted.phase_margin_deg, "wanted at least"),
        ("sensitivity_peak", "largest |S|", wanted.sensitivity_peak, "wanted at most"),
    ]
    width = 7.5 if len(joints) == 1 else 4.5 * len(joints)
    with page(path, rows=len(rows), columns=len(joints), size=(width, 7.5), sharex=True) as axes:
        for column, (channel, joint) in enumerate(zip(tuning.mechanism.channels, joints, strict=True)):
            loops = [loop for loop in tuning.best.loops if loop.channel == channel]
            at, name, unit = places(tuning, loops)
            for axis, row in zip(axes[:, column], rows, strict=True):
                _draw_margin(axis, at, loops, *row)
            axes[-1, column].set_xlabel(f"{name} [{unit}]" if unit else f"{name} number")
            if len(joints) > 1:
                axes[0, column].set_title(f"loop of {joint.name}", fontsize=10, pad=24)
        outside_legend(axes[0, 0])
        axes[0, 0].figure.suptitle(f"{tuning.mechanism.name}: {tuning.message}", fontsize=10, wrap=True)
    return axes[0, 0].figure


def _draw_margin(axis, at: np.ndarray, loops: Sequence[JudgedLoop], name: str, label: str, limit: float, what: str) -> None:
    """Draw one figure of the margins over the places (n,), with its required value and the unstable places."""
    values = np.array([getattr(loop.margins, name) for loop in loops], dtype=float)
    order = np.argsort(at)
    axis.plot(at[order], values[order], color=BLUE, marker="o", label="with the gains found")
    unstable = [place for place, loop in zip(at, loops, strict=True) if not loop.margins.stable]
    for number, place in enumerate(unstable):
        axis.axvline(place, color=RED, linestyle=":", label=None if number else "unstable there")
    if np.isfinite(limit) and limit > 0:
        axis.axhline(limit, color=GREY, linestyle="--", label=what)
    axis.set_ylabel(label)
    known = [*values[np.isfinite(values)], limit if np.isfinite(limit) else 0.0]
    axis.set_ylim(0.0, 1.12 * max(known) or 1.0)  # all points are inside
