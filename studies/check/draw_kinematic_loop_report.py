"""The figure of a kinematic loop report: the mechanism at several poses of a path, and every quantity along it."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from linkplan.models.poses.reach import Reach
from linkplan.studies.check.check_report import effort_unit, inertia_unit, ratio_unit
from linkplan.studies.check.draw_mechanism import draw_poses, mark_turning
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

# Poses drawn: few enough to tell apart.
_DRAWN = 7
# Of a quantity that grows without bound next to a singular pose, what lies between these shares of its samples is shown.
_INNER = (0.05, 0.95)
# ... where the whole would be so many times as high.
_GROWN = 3.0
# An inertia that changes by more than this factor along a path is drawn on a logarithmic axis.
_LOGARITHMIC = 5.0
# Springs that take less than this share of what is held are not drawn: rounding.
_NO_SPRING = 1e-9
# A legend of more lines than this would leave no room for the lines.
_LEGEND = 12

Line = tuple[str, np.ndarray, str]  # label, values (n,), unit


def path_figure(path: KinematicLoopPath, reaches: tuple[Reach, ...], saved: Path) -> None:
    """Draw a path: the mechanism at seven poses, ratios, inertias, weight, effort at hand, singularity, closure forces."""
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
    """Return the label of the horizontal axis: the coordinate, or time where a motion has several."""
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
    """Draw lines over the path, each against its unit, of more than two units as shares; a note where there is none."""
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
    """Return lines as shares of their largest sizes, which their labels name."""
    largest = [float(np.abs(values[np.isfinite(values)]).max(initial=0.0)) or 1.0 for _, values, _ in lines]
    return [
        (f"{label} (1 is {most:.3g}{'' if unit == '1' else f' {unit}'})", values / most, "1")
        for (label, values, unit), most in zip(lines, largest, strict=True)
    ]


def _legend(axes) -> None:
    if len(axes.get_legend_handles_labels()[1]) <= _LEGEND:
        outside_legend(axes, narrow=True, fontsize=8)


def _frame(axes, lines: Sequence[np.ndarray], *, from_zero: bool = False) -> None:
    """Set vertical limits that show the path's inner part where an end of it grows without bound."""
    known = [line[np.isfinite(line)] for line in lines if np.isfinite(line).any()]
    if not known:
        return
    low, high = min(float(line.min()) for line in known), max(float(line.max()) for line in known)
    inner = [np.quantile(line, _INNER) for line in known]
    inner_low, inner_high = float(np.min(inner)), float(np.max(inner))
    if high - low > _GROWN * (inner_high - inner_low) > 0:
        low, high = inner_low, inner_high
    margin = max(0.15 * (high - low), 0.05 * max(abs(low), abs(high))) or 1.0
    axes.set_ylim(0.0 if from_zero and low >= 0 else low - margin, high + margin)


def _spans_much(lines: Sequence[np.ndarray]) -> bool:
    """Return whether the lines are all positive and one of them spans more than a few times itself."""
    rows = [line[np.isfinite(line)] for line in lines]
    return all(len(row) and row.min() > 0 for row in rows) and any(r.max() > _LOGARITHMIC * r.min() for r in rows)


def draw_along(axes, path: KinematicLoopPath) -> None:
    """Draw the bodies as sticks at poses spread over the path; strong, the home pose of a reach or the end of a motion."""
    poses = path.poses[np.linspace(0, len(path.poses) - 1, _DRAWN).astype(int)]
    draw_poses(axes, path.mechanism, poses if path.coordinate is None else np.vstack([poses, path.mechanism.home]))
    _legend(axes)


def draw_ratios(axes, path: KinematicLoopPath) -> None:
    """Draw each actuator's transmission ratio to each coordinate, but for those that are nothing all along the path."""
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
    """Draw the inertia that each actuator feels, the other coordinates free."""
    lines = [
        (actuator.name, path.reflected_inertia[:, j], "kg m2" if actuator.unit == "N.m" else "kg")
        for j, actuator in enumerate(path.mechanism.actuators)
    ]
    _draw(axes, path, lines, "inertia at the actuator", from_zero=True, log=True)


def draw_weight(axes, path: KinematicLoopPath) -> None:
    """Draw the effort on each coordinate that holds weight and springs, and the weight's own where they differ."""
    joints = path.mechanism.independent_joints
    needed = np.einsum("ksu,ku->ks", path.ratio, path.holding_effort) + path.unheld_effort
    lines = [(joint.name, needed[:, i], effort_unit(joint)) for i, joint in enumerate(joints)]
    if np.abs(needed - path.gravity_effort).max() > _NO_SPRING * max(np.abs(needed).max(), np.finfo(float).tiny):
        lines += [
            (f"{joint.name}, weight alone", path.gravity_effort[:, i], effort_unit(joint)) for i, joint in enumerate(joints)
        ]
    _draw(axes, path, lines, "holds it still")


def draw_available(axes, path: KinematicLoopPath) -> None:
    """Draw what the actuators' limits allow on each coordinate as a band, and what holds weight and springs in black."""
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
    """Draw the distance from a singular pose: the least determinant of J_z's blocks as a share of that at home."""
    _draw(axes, path, [("least of J_z's blocks", path.singularity, "1")], "det J_z as a share of home's")
    axes.axhline(0.0, color=RED, linewidth=1.0)
    axes.set_ylim(min(0.0, float(path.singularity.min())) - 0.03, 1.15 * max(1.0, float(path.singularity.max())))


def draw_closure_forces(axes, path: KinematicLoopPath) -> None:
    """Draw the size of each closure's force while weight and springs are held."""
    names = path.mechanism.closure_names
    lines = [(name, path.closure_force[:, c], "N") for c, name in enumerate(names)]
    _draw(axes, path, lines, "closure force at rest", from_zero=True)
