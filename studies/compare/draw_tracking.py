"""Figures of tracking runs: a comparison of trackers, and the source document's figure."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from linkplan.controllers.rollout import Rollout
from linkplan.studies.compare.compare import Comparison
from linkplan.studies.output.drawing import BLUE, GREY, ORANGE, SERIES, TRACKER_COLOURS, outside_legend, page

_THIN_LINE_PT = 1.1
_LIMIT = {"color": GREY, "linestyle": ":", "linewidth": 1.2}


def comparison_figure(comparison: Comparison, path: Path | None = None) -> Figure:
    """Return the figure of every tracker's motion, error and effort, saved at `path` if given.

    It shows the motion and error of every independent joint, the motion of every dependent joint and the effort of every
    actuator. The left column has the runs as modelled, the right column those with the mismatch.
    """
    cases = [(comparison.title, comparison.nominal)]
    if comparison.mismatch is not None:
        cases.append((comparison.mismatch.name, comparison.mismatched))
    mechanism = comparison.plan.problem.mechanism
    moved, pushed = mechanism.independent_joints, mechanism.actuators
    rows = 2 * len(moved) + len(mechanism.dependent) + len(pushed)
    height = 2.5 if rows <= 4 else 1.9
    with page(path, rows=rows, columns=len(cases), size=(5.6 * len(cases), height * rows), sharex="col") as axes:
        for column, (title, runs) in enumerate(cases):
            cells = iter(axes[:, column])
            for k in range(len(moved)):
                draw_tracking(next(cells), runs, moved[k], k)
                draw_tracking_error(next(cells), runs, moved[k], k)
            for index in mechanism.dependent:
                draw_following(next(cells), runs, mechanism.joints[int(index)], int(index))
            for k, actuator in enumerate(pushed):
                draw_applied_effort(next(cells), runs, actuator, k)
            if any("limit" in cell.get_legend_handles_labels()[1] for cell in axes[1:, column]):
                axes[0, column].plot([], [], label="effort limit", **_LIMIT)
            axes[0, column].set_title(f"{comparison.plan.problem.name}: {title}", pad=24)
            outside_legend(axes[0, column])
            axes[-1, column].set_xlabel("time [s]")
    return axes[0, 0].figure


def _colour(runs: Mapping[str, Rollout], name: str) -> str:
    """Return a tracker's colour: fixed for a built-in tracker, else the next unused one."""
    others = [other for other in runs if other not in TRACKER_COLOURS]
    taken = {TRACKER_COLOURS[other] for other in runs if other in TRACKER_COLOURS}
    left = [colour for colour in SERIES if colour not in taken] or SERIES
    return TRACKER_COLOURS[name] if name in TRACKER_COLOURS else left[others.index(name) % len(left)]


def _look(runs: Mapping[str, Rollout], name: str) -> dict:
    """Return a tracker's colour and line width; later lines are thinner, so that the lines below stay visible."""
    place = list(runs).index(name) / max(1, len(runs) - 1)
    return {"color": _colour(runs, name), "linewidth": 3.2 + place * (_THIN_LINE_PT - 3.2)}


def draw_tracking(axes, runs: Mapping[str, Rollout], joint, k: int = 0) -> None:
    """Draw the k-th independent joint's motion: desired (dashed) and actual (solid)."""
    factor = joint.shown(1.0)
    for name, rollout in runs.items():
        axes.plot(rollout.time_s, factor * rollout.position[:, k], **_look(runs, name), label=name)
    longest = max(runs.values(), key=lambda rollout: len(rollout.time_s))
    axes.plot(
        longest.time_s, factor * longest.reference[:, k], color="black", linestyle="--", linewidth=1.0, label="desired"
    )
    axes.set_ylabel(f"{joint.name} [{joint.unit}]")


def draw_following(axes, runs: Mapping[str, Rollout], joint, index: int) -> None:
    """Draw a dependent joint's motion, by its index among all joints."""
    for name, rollout in runs.items():
        axes.plot(rollout.time_s, joint.shown(1.0) * rollout.pose[:, index], **_look(runs, name))
    axes.set_ylabel(f"{joint.name} [{joint.unit}]")


def draw_tracking_error(axes, runs: Mapping[str, Rollout], joint, k: int = 0) -> None:
    """Draw the absolute error of the k-th independent joint on a logarithmic axis."""
    factor = joint.shown(1.0)
    for name, rollout in runs.items():
        error = np.maximum(np.abs(factor * rollout.error[:, k]), 1e-7)
        axes.semilogy(rollout.time_s, error, color=_colour(runs, name), linewidth=_THIN_LINE_PT)
    axes.set_ylim(bottom=1e-5)
    axes.set_ylabel(f"|error of {joint.name}| [{joint.unit}]")


def draw_applied_effort(axes, runs: Mapping[str, Rollout], actuator, k: int = 0) -> None:
    """Draw the k-th actuator's applied effort, and its limits if the effort comes close to them."""
    peak = 0.0
    for name, rollout in runs.items():
        axes.plot(rollout.time_s, rollout.applied[:, k], **_look(runs, name))
        peak = max(peak, float(np.abs(rollout.applied[:, k]).max()))
    for bound in next(iter(runs.values())).effort_limit[k]:
        if np.isfinite(bound) and abs(bound) < 2 * peak:
            axes.axhline(bound, label="limit", **_LIMIT)
    axes.set_ylabel(f"{actuator.name} [{actuator.unit}]")


def document_figure(runs: Mapping[tuple[str, float], Rollout], kp: float, path: Path) -> None:
    """Draw the source document's figure: desired (dashed) and actual (solid) angle [deg].

    Args:
        runs: by (model's title, kd), with a column for each model and a row for each kd.
        kp: the common proportional gain.
        path: the image file.
    """
    titles = list(dict.fromkeys(title for title, _ in runs))
    gains = list(dict.fromkeys(kd for _, kd in runs))
    with page(
        path, rows=len(gains), columns=len(titles), size=(5.6 * len(titles), 3.2 * len(gains)), sharex=True, sharey=True
    ) as axes:
        for (title, kd), rollout in runs.items():
            cell = axes[gains.index(kd), titles.index(title)]
            draw_desired_and_actual(cell, rollout)
            rms = float(np.sqrt(np.mean(np.degrees(rollout.error[:, 0]) ** 2)))
            saturated = 100 * float(np.mean(np.abs(rollout.applied[:, 0]) >= 0.999 * rollout.effort_limit[0, 1]))
            cell.set_title(
                f"{title}: KP = {kp:g}, KD = {kd:g}\nrms error {rms:.3g} deg, {saturated:.0f} % of the time at the limit"
            )
        for cell in axes[-1]:
            cell.set_xlabel("time [s]")
        for cell in axes[:, 0]:
            cell.set_ylabel("joint O [deg]")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        axes[0, 0].figure.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False)


def draw_desired_and_actual(axes, rollout: Rollout) -> None:
    """Draw the first independent joint's desired angle (dashed) and actual angle (solid) [deg]."""
    axes.plot(rollout.time_s, np.degrees(rollout.position[:, 0]), color=ORANGE, linewidth=1.2, label="actual")
    axes.plot(
        rollout.time_s, np.degrees(rollout.reference[:, 0]), color=BLUE, linestyle="--", linewidth=1.6, label="desired"
    )
