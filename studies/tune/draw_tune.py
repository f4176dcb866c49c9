"""Figure of tuned gains: bandwidth, phase margin and sensitivity peak at every pose, with their required values."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from linkplan.studies.output.drawing import BLUE, GREY, RED, outside_legend, page
from linkplan.studies.tune.tune import Tuning


def tune_figure(tuning: Tuning, path: Path | None = None) -> Figure:
    """Return the figure of the margins over the joint's position, with unstable poses marked, saved at `path` if given."""
    joint, wanted = tuning.mechanism.independent_joints[0], tuning.wanted
    rows = [
        ("bandwidth_hz", "bandwidth [Hz]", wanted.bandwidth_hz, "wanted at least"),
        ("phase_margin_deg", "phase margin [deg]", wanted.phase_margin_deg, "wanted at least"),
        ("sensitivity_peak", "largest |S|", wanted.sensitivity_peak, "wanted at most"),
    ]
    at = np.array([joint.shown(point.state[0]) for point in tuning.points])
    order, bounds = np.argsort(at), tuning.best.bounds
    with page(path, rows=len(rows), size=(7.5, 7.5), sharex=True) as axes:
        for axis, (name, label, limit, what) in zip(axes[:, 0], rows, strict=True):
            values = np.array([getattr(bound, name) for bound in bounds], dtype=float)
            axis.plot(at[order], values[order], color=BLUE, marker="o", label="with the gains found")
            unstable = [place for place, bound in zip(at, bounds, strict=True) if not bound.stable]
            for number, place in enumerate(unstable):
                axis.axvline(place, color=RED, linestyle=":", label=None if number else "unstable there")
            if np.isfinite(limit) and limit > 0:
                axis.axhline(limit, color=GREY, linestyle="--", label=what)
            axis.set_ylabel(label)
            known = [*values[np.isfinite(values)], limit if np.isfinite(limit) else 0.0]
            axis.set_ylim(0.0, 1.12 * max(known) or 1.0)  # all points are inside
        outside_legend(axes[0, 0])
        axes[-1, 0].set_xlabel(f"{joint.name} [{joint.unit}]")
        axes[0, 0].set_title(f"{tuning.mechanism.name}: {tuning.message}", fontsize=10, pad=24, wrap=True)
    return axes[0, 0].figure
