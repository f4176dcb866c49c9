"""Figure of a stability map: gains that are stable at all poses, contours of the phase margin, MuJoCo's results."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from linkplan.studies.bode.map_study import TRIAL_GAIN_SHARE, MapStudy
from linkplan.studies.output.drawing import BLACK, BLUE, ORANGE, RED, page

_CONTOURS_DEG = (15, 30, 45, 60)


def map_figure(study: MapStudy, path: Path, marked: Sequence[tuple[str, float, float]] | None = None) -> None:
    """Draw the map, and next to it the stable damping gains over the joint's position.

    Args:
        study: the map study.
        path: the image file.
        marked: (name, kp, kd) of gains to mark; default: the study's own.
    """
    marked = [("these gains", study.kp, study.kd)] if marked is None else marked
    with page(path, rows=1, columns=2, size=(12.0, 5.4), gridspec_kw={"width_ratios": [1.25, 1]}) as axes:
        draw_map(axes[0, 0], study, marked)
        draw_critical(axes[0, 1], study, marked)
        entries: dict[str, object] = {}
        for cell in axes[0]:
            handles, labels = cell.get_legend_handles_labels()
            entries |= {label: handle for handle, label in zip(handles, labels, strict=True) if label not in entries}
        axes[0, 0].figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=4, frameon=False)


def draw_map(axes, study: MapStudy, marked) -> None:
    """Draw the plane of gains: the region stable at every pose, phase margins, and MuJoCo's results near the border."""
    found = study.found
    joint = found.points[0].mechanism.independent_joints[0]
    force = "N.m" if joint.kind == "hinge" else "N"
    turn = "rad" if joint.kind == "hinge" else "m"
    kp, kd, radius = found.border
    axes.contourf(kd, kp, radius, levels=[1.0, np.inf], colors=[RED], alpha=0.18)
    axes.contour(kd, kp, radius, levels=[1.0], colors=[RED], linewidths=1.8)
    axes.contour(found.kd, found.kp, found.phase_margin_deg, levels=_CONTOURS_DEG, colors=[BLUE], linewidths=0.9, alpha=0.8)
    row = len(found.kp) // 3
    for level in _CONTOURS_DEG:
        enough = np.flatnonzero(np.nan_to_num(found.phase_margin_deg[row]) >= level)
        if enough.size:
            place = found.kd[enough[0]], found.kp[row]
            axes.text(*place, f"{level:g} deg", rotation=45, fontsize=8, color=BLUE, ha="center", va="bottom")
    axes.plot([], [], color=RED, linewidth=1.8, label="predicted stability boundary, worst pose")
    axes.plot([], [], color=BLUE, linewidth=0.9, label="least phase margin")
    if found.trials is not None:
        tried = np.array([(kp, kd) for kp, kd, _ in found.tried])
        for settles, marker, fill, label in (
            (True, "o", "full", "settles in MuJoCo"),
            (False, "x", "full", "does not settle"),
        ):
            which = found.trials.settles == settles
            axes.plot(tried[which, 1], tried[which, 0], marker, color=BLACK, markersize=5, fillstyle=fill, label=label)
    for (name, kp, kd), marker in zip(marked, "*PD^v", strict=False):
        axes.plot([kd], [kp], marker, color=ORANGE, markersize=13, markeredgecolor=BLACK, label=name, linestyle="none")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(found.kd[0], found.kd[-1])
    axes.set_ylim(found.kp[0], found.kp[-1])
    axes.set_xlabel(f"kd [{force}.s/{turn}]")
    axes.set_ylabel(f"kp [{force}/{turn}]")
    delay = f", delay {found.timing.delay_s:g} s" if found.timing.delay_steps else ""
    axes.set_title(f"stable gains, sampled every {found.timing.period_s:g} s{delay}")


def draw_critical(axes, study: MapStudy, marked) -> None:
    """Draw the largest stable damping gain over the joint's position, and the marked gains."""
    found = study.found
    joint = found.points[0].mechanism.independent_joints[0]
    at = np.array([joint.shown(point.state[0]) for point in found.points])
    high = study.critical[:, 1]
    inertia = np.array([float(point.inertia[0, 0]) for point in found.points])
    axes.plot(at, high, color=RED, linewidth=1.8, label=f"largest stable kd at kp = {study.kp:g}")
    if not found.timing.delay_steps:
        axes.plot(at, 2 * inertia / found.timing.period_s, color=BLACK, linestyle=":", linewidth=1.2, label="2 J / T")
    for column, share in enumerate((1 - TRIAL_GAIN_SHARE, 1 + TRIAL_GAIN_SHARE)):
        for settles, marker in ((True, "o"), (False, "x")):
            which = study.settles_near_border[:, column] == settles
            axes.plot(at[which], share * high[which], marker, color=BLACK, markersize=5)
    axes.fill_between(at, high, max(np.nanmax(high), *[kd for _, _, kd in marked]) * 3, color=RED, alpha=0.18, linewidth=0)
    for (name, _, kd), style in zip(marked, ("-", "-.", ":", "--"), strict=False):
        axes.axhline(kd, color=ORANGE, linestyle=style, linewidth=1.6)
        axes.text(at[0], 1.05 * kd, name, fontsize=8.5, va="bottom")
    axes.set_yscale("log")
    force = "N.m.s/rad" if joint.kind == "hinge" else "N.s/m"
    axes.set_ylabel(f"kd [{force}]")
    axes.set_xlabel(f"{joint.name} [{joint.unit}]")
    axes.set_title("stable kd over the angle")
