"""The figure of a kinematic loop report: the mechanism at several poses of a path, and every quantity along the path."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from linkplan.models.poses.reach import Reach
from linkplan.studies.check.check_report import effort_unit, inertia_unit, ratio_unit
from linkplan.studies.check.draw_mechanism import LOG_AXIS_FACTOR, draw_poses, mark_turning, visible_springs
from linkplan.studies.check.kinematic_loop_report import KinematicLoopPath, acts
from linkplan.studies.output.drawing import (
    BLACK,
    GREY,
    RED,
    SERIES,
    STYLES,
    level_zeros,
    outside_legend,
    page,
    sides_by_unit,
)

Line = tuple[str, np.ndarray, str]  # label, values (n,), unit


def path_figure(path: KinematicLoopPath, reaches: tuple[Reach, ...], saved: Path) -> None:
    """Draw a path: the mechanism at seven poses, ratios, inertias, weight, available effort, singularity, closure forces."""
    rows = 4 if path.mechanism.closures else 3
    with page(saved, rows=rows, columns=2, size=(10.5, 3.5 * rows)) as axes:
        draw_along(axes[0, 0], path)
        draw_ratios(axes[0, 1], path)
        draw_reduced(axes[1, 0], path)
        draw_reflected(axes[1, 1], path)
        draw_weight(axes[2, 0], path)
        draw_available(axes[2, 1], path)
        if path.mechanism.closures:
            draw_singularity(axes[3, 0], path)
            draw_closure_forces(axes[3, 1], path)
        for one in axes.flat[1:]:
            one.set_xlabel(_over(path))
            if path.coordinate is not None:
                mark_turning(one, path.mechanism, reaches[path.coordinate])
        axes[0, 0].figure.suptitle(f"{path.mechanism.name}: along {path.title}, at rest")


def _over(path: KinematicLoopPath) -> str:
    """Return the label of the horizontal axis: the coordinate, or time for a motion of several coordinates."""
    if path.coordinate is None and path.mechanism.dof > 1:
        return "time of the path [s]"
    joint = path.mechanism.independent_joints[path.coordinate or 0]
    return f"{joint.name} [{joint.unit}]"


def _x(path: KinematicLoopPath) -> np.ndarray:
    if path.coordinate is None and path.mechanism.dof > 1 and path.time_s is not None:
        return path.time_s
    column = path.coordinate or 0
    joint = path.mechanism.independent_joints[column]
    return np.array([joint.shown(x) for x in path.positions[:, column]])


def _draw(
    axes, path: KinematicLoopPath, lines: Sequence[Line], what: str, *, from_zero: bool = False, log: bool = False
) -> None:
    """Draw lines over the path, each on the axis of its unit. Lines of more than two units are drawn as shares."""
    if len({unit for *_, unit in lines}) > 2:
        lines, what = shares(lines), f"{what}, of its largest"
    x, sides = _x(path), sides_by_unit(axes, what, [unit for *_, unit in lines])
    for k, (label, values, unit) in enumerate(lines):
        look = {"color": SERIES[k % len(SERIES)], "linestyle": STYLES[k % len(STYLES)]}
        sides[unit].plot(x, values, **look)
        axes.plot([], [], label=label if len(set(sides.values())) == 1 else f"{label} [{unit}]", **look)
    for side in set(sides.values()):
        of_it = [values for _, values, unit in lines if sides[unit] is side]
        if log and _spans_much(of_it):
            side.set_yscale("log")
        else:
            _frame(side, of_it, from_zero=from_zero)
    level_zeros(set(sides.values()))
    if lines:
        _legend(axes)
    else:
        axes.set_ylabel(what)
        axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", color=GREY)


def shares(lines: Sequence[Line]) -> list[Line]:
    """Return lines as shares of their largest absolute values, with these values in the labels."""
    largest = [float(np.abs(values[np.isfinite(values)]).max(initial=0.0)) or 1.0 for _, values, _ in lines]
    return [
        (f"{label} (1 is {most:.3g}{'' if unit == '1' else f' {unit}'})", values / most, "1")
        for (label, values, unit), most in zip(lines, largest, strict=True)
    ]


def _legend(axes) -> None:
    if len(axes.get_legend_handles_labels()[1]) <= 12:  # a larger legend would leave no space for the lines
        outside_legend(axes, narrow=True, fontsize=8)


def _frame(axes, lines: Sequence[np.ndarray], *, from_zero: bool = False) -> None:
    """Set vertical limits around the inner 90 % of the values if the whole range is three times as high, else around all.

    Quantities grow without bound next to a singular pose.
    """
    known = [line[np.isfinite(line)] for line in lines if np.isfinite(line).any()]
    if not known:
        return
    low, high = min(float(line.min()) for line in known), max(float(line.max()) for line in known)
    inner = [np.quantile(line, (0.05, 0.95)) for line in known]
    inner_low, inner_high = float(np.min(inner)), float(np.max(inner))
    if high - low > 3 * (inner_high - inner_low) > 0:
        low, high = inner_low, inner_high
    margin = max(0.15 * (high - low), 0.05 * max(abs(low), abs(high))) or 1.0
    axes.set_ylim(0.0 if from_zero and low >= 0 else low - margin, high + margin)


def _spans_much(lines: Sequence[np.ndarray]) -> bool:
    """Tell if all lines are positive and one of them changes by more than `LOG_AXIS_FACTOR`."""
    rows = [line[np.isfinite(line)] for line in lines]
    return all(len(row) and row.min() > 0 for row in rows) and any(r.max() > LOG_AXIS_FACTOR * r.min() for r in rows)


def draw_along(axes, path: KinematicLoopPath) -> None:
    """Draw the bodies as sticks at seven poses of the path; the home pose of a reach or the end of a motion is opaque."""
    poses = path.poses[np.linspace(0, len(path.poses) - 1, num=7).astype(int)]
    draw_poses(axes, path.mechanism, poses if path.coordinate is None else np.vstack([poses, path.mechanism.home]))
    _legend(axes)


def draw_ratios(axes, path: KinematicLoopPath) -> None:
    """Draw each actuator's transmission ratio to each coordinate on which it acts."""
    lines = [
        (f"{actuator.name} to {joint.name}", path.ratio[:, i, j], ratio_unit(joint, actuator.unit))
        for i, joint in enumerate(path.mechanism.independent_joints)
        for j, actuator in enumerate(path.mechanism.actuators)
        if acts(path)[i, j]
    ]
    _draw(axes, path, lines, "transmission ratio")


def draw_reduced(axes, path: KinematicLoopPath) -> None:
    """Draw the reduced inertia along each coordinate."""
    joints = path.mechanism.independent_joints
    lines = [(joint.name, path.reduced_inertia[:, i, i], inertia_unit(joint)) for i, joint in enumerate(joints)]
    _draw(axes, path, lines, "reduced inertia", from_zero=True, log=True)


def draw_reflected(axes, path: KinematicLoopPath) -> None:
    """Draw the reflected inertia at each actuator, with the other coordinates free."""
    lines = [
        (actuator.name, path.reflected_inertia[:, j], "kg m2" if actuator.unit == "N.m" else "kg")
        for j, actuator in enumerate(path.mechanism.actuators)
    ]
    _draw(axes, path, lines, "inertia at the actuator", from_zero=True, log=True)


def draw_weight(axes, path: KinematicLoopPath) -> None:
    """Draw the effort on each coordinate that holds weight and springs, and that for the weight alone if it differs."""
    joints = path.mechanism.independent_joints
    needed = np.einsum("ksu,ku->ks", path.ratio, path.holding_effort) + path.unheld_effort
    lines = [(joint.name, needed[:, i], effort_unit(joint)) for i, joint in enumerate(joints)]
    if visible_springs(needed, path.gravity_effort):
        lines += [
            (f"{joint.name}, weight alone", path.gravity_effort[:, i], effort_unit(joint)) for i, joint in enumerate(joints)
        ]
    _draw(axes, path, lines, "holds it still")


def draw_available(axes, path: KinematicLoopPath) -> None:
    """Draw the available effort on each coordinate as a band, and the effort that holds weight and springs in black."""
    joints, x = path.mechanism.independent_joints, _x(path)
    sides = sides_by_unit(axes, "effort within limits", [effort_unit(joint) for joint in joints])
    needed = np.einsum("ksu,ku->ks", path.ratio, path.holding_effort) + path.unheld_effort
    lines: dict = {side: [] for side in sides.values()}
    for i, joint in enumerate(joints):
        side, (low, high) = sides[effort_unit(joint)], path.available_effort[:, i].T
        colour, style = SERIES[i % len(SERIES)], STYLES[i % len(STYLES)]
        if np.isfinite(path.available_effort[:, i]).all():
            side.fill_between(x, low, high, color=colour, alpha=0.15, linewidth=0)
        side.plot(x, np.column_stack([low, high]), color=colour, linestyle=style)
        side.plot(x, needed[:, i], color=BLACK, linestyle=style)
        lines[side] += [low, high, needed[:, i]]
        unit = f" [{effort_unit(joint)}]" if len(lines) > 1 else ""
        axes.plot([], [], color=colour, linestyle=style, label=f"{joint.name} available{unit}")
        axes.plot([], [], color=BLACK, linestyle=style, label=f"{joint.name} to hold still{unit}")
    for side, of_it in lines.items():
        _frame(side, of_it)
    level_zeros(set(lines))
    _legend(axes)


def draw_singularity(axes, path: KinematicLoopPath) -> None:
    """Draw the distance from a singular pose: the least determinant of J_z's blocks relative to home."""
    _draw(axes, path, [("least of J_z's blocks", path.singularity, "1")], "det J_z as a share of home's")
    axes.axhline(0.0, color=RED, linewidth=1.0)
    axes.set_ylim(min(0.0, float(path.singularity.min())) - 0.03, 1.15 * max(1.0, float(path.singularity.max())))


def draw_closure_forces(axes, path: KinematicLoopPath) -> None:
    """Draw the norm of each closure's force while the actuators hold weight and springs."""
    names = path.mechanism.closure_names
    lines = [(name, path.closure_force[:, c], "N") for c, name in enumerate(names)]
    _draw(axes, path, lines, "closure force at rest", from_zero=True)
