"""Figures of a plan: motion and effort over time, active limits, the paths of the sites that its problem names."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from linkplan.planner.plan import Plan
from linkplan.studies.output.draw_sites import draw_sites
from linkplan.studies.output.drawing import BLACK, GREY, SERIES, STYLES, level_zeros, outside_legend, page, sides_by_unit


def plan_figure(plan: Plan, path: Path | None = None) -> Figure:
    """Return the figure of a plan's positions, speeds and efforts, saved at `path` if it is given."""
    sites = bool(plan.problem.sites)
    with page(path, rows=3, columns=1 + sites, size=(7.5 + 6.0 * sites, 7.5), sharex="col") as axes:
        draw_position(axes[0, 0], plan)
        draw_velocity(axes[1, 0], plan)
        draw_effort(axes[2, 0], plan)
        axes[0, 0].figure.suptitle(f"{plan.problem.name}: {plan.message}", fontsize=10, wrap=True)
        axes[2, 0].set_xlabel(_time_label(plan))
        if sites:
            figure, grid = axes[0, 1].figure, axes[0, 1].get_gridspec()
            for side in axes[:, 1]:
                side.remove()
            draw_sites(figure.add_subplot(grid[:, 1]), plan)
    return axes[0, 0].figure


def _time_scale(plan: Plan) -> float:
    return 1e3 if plan.trajectory.duration_s < 0.02 else 1.0


def _style(column: int) -> dict[str, str]:
    """Return a line's colour and style; the style changes when the colours repeat."""
    return {"color": SERIES[column % len(SERIES)], "linestyle": STYLES[column // len(SERIES) % len(STYLES)]}


def _time_label(plan: Plan) -> str:
    return "time [ms]" if _time_scale(plan) == 1e3 else "time [s]"


def draw_position(axes, plan: Plan) -> None:
    """Draw the independent positions, and the reference, if there is one, as dashed lines."""
    trajectory, reference = plan.trajectory, plan.problem.reference
    time, joints = trajectory.dense_times(10), plan.problem.mechanism.independent_joints
    shown, sides = _time_scale(plan) * time, sides_by_unit(axes, "position", [joint.unit for joint in joints])
    for column, joint in enumerate(joints):
        factor, side = joint.shown(1.0), sides[joint.unit]
        side.plot(shown, factor * trajectory.position_at(time)[:, column], **_style(column))
        axes.plot([], [], label=_labelled(f"{joint.name} planned", joint.unit, sides), **_style(column))
        if reference is not None:
            wanted = factor * reference.derivative(time)[:, column]
            side.plot(shown, wanted, color=BLACK, linestyle="--", linewidth=1.0)
            label = _labelled(f"{joint.name} reference", joint.unit, sides)
            axes.plot([], [], color=BLACK, linestyle="--", linewidth=1.0, label=label)
    outside_legend(axes)


def _labelled(text: str, unit: str, sides: dict) -> str:
    return text if len(sides) == 1 else f"{text} [{unit}]"


def draw_velocity(axes, plan: Plan) -> None:
    """Draw the independent speeds."""
    time, joints = plan.trajectory.dense_times(10), plan.problem.mechanism.independent_joints
    sides = sides_by_unit(axes, "speed", [f"{joint.unit}/s" for joint in joints])
    for column, joint in enumerate(joints):
        values = joint.shown(1.0) * plan.trajectory.velocity_at(time)[:, column]
        sides[f"{joint.unit}/s"].plot(_time_scale(plan) * time, values, **_style(column))
    level_zeros(set(sides.values()))


def draw_effort(axes, plan: Plan) -> None:
    """Draw the efforts, and the limits below twice the largest effort."""
    trajectory = plan.trajectory
    time = trajectory.dense_times(10)
    effort, actuators = trajectory.effort_at(time), plan.problem.mechanism.actuators
    sides = sides_by_unit(axes, "effort", [actuator.unit for actuator in actuators])
    limit_style = {"color": GREY, "linestyle": ":", "linewidth": 1.2}
    has_limits = False
    for column, actuator in enumerate(actuators):
        side = sides[actuator.unit]
        side.plot(_time_scale(plan) * time, effort[:, column], **_style(column))
        axes.plot([], [], label=_labelled(actuator.name, actuator.unit, sides), **_style(column))
        peak = np.abs(effort[:, column]).max()
        for bound in plan.problem.limits.effort[column]:
            if np.isfinite(bound) and abs(bound) < 2 * peak:
                side.axhline(bound, **limit_style)
                has_limits = True
    if has_limits:
        axes.plot([], [], label="effort limit", **limit_style)
    level_zeros(set(sides.values()))
    outside_legend(axes)
