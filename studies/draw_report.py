"""The figure of a loop report: the mechanism at several poses of a path, and every quantity along it."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from models.assembly import Reach
from studies.check_report import effort_unit, inertia_unit, ratio_unit
from studies.draw_mechanism import draw_poses, mark_turning
from studies.drawing import BLACK, GREY, RED, SERIES, outside_legend, page
from studies.loop_report import LoopPath, acts

# Poses drawn: few enough to tell apart.
_DRAWN = 7
# Of a quantity that grows without bound next to a singular pose, what lies between these shares of its samples is shown.
_INNER = (0.05, 0.95)
# ... where the whole would be so many times as high.
_GROWN = 3.0
# An inertia that changes by more than this factor along a path is drawn on a logarithmic axis.
_LOGARITHMIC = 5.0
# A legend of more lines than this would leave no room for the lines.
_LEGEND = 12
# Solid, dashed, dotted ...: lines of one panel that lie on one another stay visible.
_STYLES = ("-", "--", ":", "-.")

Line = tuple[str, np.ndarray]


def path_figure(path: LoopPath, reaches: tuple[Reach, ...], saved: Path) -> None:
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


def _over(path: LoopPath) -> str:
    """Return the label of the horizontal axis: the coordinate, or time where a motion has several."""
    if path.coordinate is None and path.mechanism.dof > 1:
        return "time of the path [s]"
    joint = path.mechanism.independent_joints[path.coordinate or 0]
    return f"{joint.name} [{joint.unit}]"


def _x(path: LoopPath) -> np.ndarray:
    if path.coordinate is None and path.mechanism.dof > 1 and path.time_s is not None:
        return path.time_s
    column = path.coordinate or 0
    joint = path.mechanism.independent_joints[column]
    return np.array([joint.shown(x) for x in path.positions[:, column]])


def _draw(axes, path: LoopPath, lines: Sequence[Line], what: str, units: Sequence[str]) -> None:
    """Draw lines over the path with the quantity and its units on the vertical axis; a note where there is none."""
    x = _x(path)
    for k, (label, values) in enumerate(lines):
        colour, style = SERIES[k % len(SERIES)], _STYLES[k % len(_STYLES)]
        axes.plot(x, values, color=colour, linestyle=style, label=label)
    names = list(dict.fromkeys(units))
    axes.set_ylabel(what if names in ([], ["1"]) else f"{what} [{', '.join(names)}]")
    if lines:
        _legend(axes)
    else:
        axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", color=GREY)


def _legend(axes) -> None:
    if len(axes.get_legend_handles_labels()[1]) <= _LEGEND:
        outside_legend(axes, narrow=True, fontsize=8)


def _frame(axes, lines: Sequence[Line], *, from_zero: bool = False) -> None:
    """Set vertical limits that show the path's inner part where an end of it grows without bound."""
    values = np.concatenate([line[np.isfinite(line)] for _, line in lines]) if lines else np.zeros(0)
    if not len(values):
        return
    low, high = float(values.min()), float(values.max())
    inner = [np.quantile(line[np.isfinite(line)], _INNER) for _, line in lines if np.isfinite(line).any()]
    inner_low, inner_high = float(np.min(inner)), float(np.max(inner))
    if high - low > _GROWN * (inner_high - inner_low) > 0:
        low, high = inner_low, inner_high
    size = max(abs(low), abs(high))
    margin = max(0.15 * (high - low), 0.05 * size) or 1.0
    axes.set_ylim(0.0 if from_zero and low >= 0 else low - margin, high + margin)


def _logarithmic(axes, lines: Sequence[Line]) -> None:
    """Make the axis logarithmic where one of the lines, all positive, spans more than a few times itself."""
    rows = [line[np.isfinite(line)] for _, line in lines]
    if rows and all(len(row) and row.min() > 0 for row in rows) and any(r.max() > _LOGARITHMIC * r.min() for r in rows):
        axes.set_yscale("log")
    else:
        _frame(axes, lines, from_zero=True)


def draw_along(axes, path: LoopPath) -> None:
    """Draw the bodies as sticks at poses spread over the path; strong, the home pose of a reach or the end of a motion."""
    poses = path.poses[np.linspace(0, len(path.poses) - 1, _DRAWN).astype(int)]
    draw_poses(axes, path.mechanism, poses if path.coordinate is None else np.vstack([poses, path.mechanism.home]))
    _legend(axes)


def draw_ratios(axes, path: LoopPath) -> None:
    """Draw each actuator's transmission ratio to each coordinate, but for those that are nothing all along the path."""
    lines, units = [], []
    for i, joint in enumerate(path.mechanism.independent_joints):
        for j, actuator in enumerate(path.mechanism.actuators):
            if acts(path)[i, j]:
                lines.append((f"{actuator.name} to {joint.name}", path.ratio[:, i, j]))
                units.append(ratio_unit(joint, actuator.unit))
    _draw(axes, path, lines, "transmission ratio", units)
    _frame(axes, lines)


def draw_reduced(axes, path: LoopPath) -> None:
    """Draw the reduced inertia along each coordinate."""
    joints = path.mechanism.independent_joints
    lines = [(joint.name, path.reduced_inertia[:, i, i]) for i, joint in enumerate(joints)]
    _draw(axes, path, lines, "reduced inertia", [inertia_unit(joint) for joint in joints])
    _logarithmic(axes, lines)


def draw_reflected(axes, path: LoopPath) -> None:
    """Draw the inertia that each actuator feels, the other coordinates free."""
    actuators = path.mechanism.actuators
    lines = [(actuator.name, path.reflected_inertia[:, j]) for j, actuator in enumerate(actuators)]
    _draw(axes, path, lines, "inertia at the actuator", ["kg m2" if a.unit == "N.m" else "kg" for a in actuators])
    _logarithmic(axes, lines)


def draw_weight(axes, path: LoopPath) -> None:
    """Draw the effort on each coordinate that holds the weight."""
    joints = path.mechanism.independent_joints
    lines = [(joint.name, path.gravity_effort[:, i]) for i, joint in enumerate(joints)]
    _draw(axes, path, lines, "effort that holds the weight", [effort_unit(joint) for joint in joints])
    _frame(axes, lines)


def draw_available(axes, path: LoopPath) -> None:
    """Draw what the actuators' limits allow on each coordinate as a band, and what holds it in black."""
    joints, x, lines = path.mechanism.independent_joints, _x(path), []
    for i, joint in enumerate(joints):
        low, high = path.available_effort[:, i].T
        colour, style = SERIES[i % len(SERIES)], _STYLES[i % len(_STYLES)]
        if np.isfinite(path.available_effort[:, i]).all():
            axes.fill_between(x, low, high, color=colour, alpha=0.15, linewidth=0)
        axes.plot(x, low, color=colour, linestyle=style, label=f"{joint.name} available")
        axes.plot(x, high, color=colour, linestyle=style)
        lines += [("low", low), ("high", high)]
    needed = np.einsum("ksu,ku->ks", path.ratio, path.holding_effort) + path.unheld_effort
    for i, joint in enumerate(joints):
        axes.plot(x, needed[:, i], color=BLACK, linestyle=_STYLES[i % len(_STYLES)], label=f"{joint.name} to hold still")
        lines.append(("needed", needed[:, i]))
    _legend(axes)
    units = [effort_unit(joint) for joint in joints]
    axes.set_ylabel(f"effort within limits [{', '.join(dict.fromkeys(units))}]")
    _frame(axes, lines)


def draw_singularity(axes, path: LoopPath) -> None:
    """Draw the distance from a singular pose: the least determinant of J_z's blocks as a share of that at home."""
    _draw(axes, path, [("least of J_z's blocks", path.singularity)], "det J_z as a share of home's", [])
    axes.axhline(0.0, color=RED, linewidth=1.0)
    axes.set_ylim(min(0.0, float(path.singularity.min())) - 0.03, 1.15 * max(1.0, float(path.singularity.max())))


def draw_closure_forces(axes, path: LoopPath) -> None:
    """Draw the size of each closure's force while weight and springs are held."""
    names = path.mechanism.closure_names
    lines = [(name, path.closure_force[:, c]) for c, name in enumerate(names)]
    _draw(axes, path, lines, "closure force at rest", ["N"])
    _frame(axes, lines, from_zero=True)
