"""Figures of a mechanism: the drawing at several poses, and the quantities that change along its reach."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled
from linkplan.models.poses.reach import Reach
from linkplan.models.poses.skeleton import sticks, view
from linkplan.models.tree.joints import Joint
from linkplan.studies.check.inspection import Inspection
from linkplan.studies.output.directions import direction_name
from linkplan.studies.output.drawing import BLACK, BLUE, GREY, RED, SERIES, STYLES, outside_legend, page

# An inertia that changes by more than this factor is drawn on a logarithmic axis.
LOG_AXIS_FACTOR = 5.0


def inspection_figure(found: Inspection, path: Path | None = None) -> Figure:
    """Return the figure of a mechanism over the reach of its first three coordinates, saved at `path` if it is given.

    The figure has the mechanism, its dependent joints, the reduced inertia, and the holding effort. Each coordinate also has
    a figure loop-N.png.
    """
    reaches, mechanism = found.reaches[:3], found.mechanism
    with page(path, rows=2 * len(reaches), columns=2, size=(10.5, 7.5 * len(reaches))) as axes:
        for row, can in zip(range(0, 2 * len(reaches), 2), reaches, strict=True):
            draw_mechanism(axes[row, 0], mechanism, can)
            draw_dependent(axes[row, 1], mechanism, can)
            draw_inertia(axes[row + 1, 0], mechanism, can)
            draw_holding(axes[row + 1, 1], mechanism, can)
        names = [mechanism.joints[mechanism.independent[can.coordinate]].name for can in reaches]
        others = "" if mechanism.dof == 1 else f": {' then '.join(names)} each over its reach, the other coordinates at home"
        axes[0, 0].figure.suptitle(f"{mechanism.name}{others}")
    return axes[0, 0].figure


def _x(mechanism: Mechanism, can: Reach) -> tuple[np.ndarray, Joint]:
    """Return the swept coordinate at the poses of a reach in its display unit, and its joint."""
    index = mechanism.independent[can.coordinate]
    joint = mechanism.joints[index]
    return np.array([joint.shown(x) for x in can.poses[:, index]]), joint


def _drawn_reach(mechanism: Mechanism, can: Reach) -> np.ndarray:
    """Return the poses of a reach or, for a joint that turns fully, those of 0.8 turns from home."""
    if not can.turns_fully:
        return can.poses
    index = mechanism.independent[can.coordinate]
    travel = can.poses[:, index] - mechanism.home[index]
    return can.poses[(travel >= 0) & (travel <= 1.6 * np.pi)]


def draw_mechanism(axes, mechanism: Mechanism, can: Reach) -> None:
    """Draw the bodies as sticks at poses spread over a reach; the home pose is opaque."""
    poses = _drawn_reach(mechanism, can)
    chosen = poses[np.linspace(0, len(poses) - 1, 5).astype(int)]
    draw_poses(axes, mechanism, np.vstack([chosen, mechanism.home]))
    outside_legend(axes, narrow=True, fontsize=8)


def draw_poses(axes, mechanism: Mechanism, poses: np.ndarray) -> None:
    """Draw the bodies as sticks at poses (n, n_q); the last one is opaque."""
    colours = iter(SERIES * 10)
    for depth, stick in enumerate(sticks(mechanism, poses)):
        colour = GREY if stick.fixed else next(colours)
        for k, pins in enumerate(stick.pins):  # a body is drawn above its children
            last = k == len(poses) - 1
            loop = np.vstack([pins, pins[:1]]) if len(pins) > 2 and not stick.fixed else pins
            axes.plot(
                loop[:, 0],
                loop[:, 1],
                color=colour,
                marker="^" if stick.fixed else "o",
                markersize=5 if last else 3,
                linestyle="" if stick.fixed else "-",
                linewidth=2.6 if last else 1.2,
                alpha=1.0 if last else 0.3,
                zorder=3.0 - 0.01 * depth,
                label=stick.body if last else None,
            )
    axes.set_aspect("equal", adjustable="datalim")
    axes.locator_params(axis="x", nbins=6)
    right, up = (direction_name(direction) for direction in view(mechanism.model))
    axes.set_xlabel(f"{right} [m]")
    axes.set_ylabel(f"{up} [m]")


def mark_turning(axes, mechanism: Mechanism, can: Reach, *, named: bool = False) -> None:
    """Draw the singular poses of a reach as red dotted lines and the turning points of dependent joints as grey ones."""
    joint = mechanism.joints[mechanism.independent[can.coordinate]]
    left, right = axes.get_xlim()
    labelled = set()
    for words, colour, positions in (
        ("singular pose", RED, can.singular),
        ("a joint turns back", GREY, [position for _, position in can.toggles]),
    ):
        for position in positions:
            if left <= joint.shown(position) <= right:  # only one turn of a joint is drawn
                label = words if named and words not in labelled else None
                axes.axvline(joint.shown(position), color=colour, linestyle=":", linewidth=1.2, label=label)
                labelled.add(words)


def draw_dependent(axes, mechanism: Mechanism, can: Reach) -> None:
    """Draw the dependent joints over the swept joint, slides on the right axis, with `mark_turning`."""
    x, joint = _x(mechanism, can)
    dependent = [(int(index), mechanism.joints[index]) for index in mechanism.dependent]
    kinds = list(dict.fromkeys(other.kind for _, other in dependent))
    sides = dict.fromkeys(kinds, axes)
    if len(kinds) == 2:
        sides["slide"] = axes.twinx()
        sides["slide"].grid(visible=False)
        sides["slide"].spines["right"].set_visible(True)
    for k, (index, other) in enumerate(dependent):
        look = {"color": SERIES[k % len(SERIES)], "linestyle": STYLES[k % len(STYLES)]}
        sides[other.kind].plot(x, [other.shown(q) for q in can.poses[:, index]], **look)
        axes.plot([], [], label=f"{other.name} [{other.unit}]", **look)
    for kind, side in sides.items():
        side.set_ylabel(f"dependent joints [{'deg' if kind == 'hinge' else 'm'}]")
    mark_turning(axes, mechanism, can, named=True)
    axes.set_xlabel(f"{joint.name} [{joint.unit}]")
    if dependent:
        outside_legend(axes, narrow=True)
    else:
        axes.set_ylabel("dependent joints")
        axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", color=GREY)
        axes.set_xticks([])
        axes.set_yticks([])


def draw_inertia(axes, mechanism: Mechanism, can: Reach) -> None:
    """Draw the reduced inertia along the swept coordinate, on a logarithmic axis if it changes much."""
    (x, joint), column = _x(mechanism, can), can.coordinate
    inertia = sampled(mechanism.dynamics.reduced_inertia, can.poses)[:, column, column]
    axes.plot(x, inertia, color=BLACK)
    if inertia.max() > LOG_AXIS_FACTOR * inertia.min() > 0:
        axes.set_yscale("log")
    else:
        axes.set_ylim(0.0, 1.2 * inertia.max())
    mark_turning(axes, mechanism, can)
    axes.set_xlabel(f"{joint.name} [{joint.unit}]")
    axes.set_ylabel(f"reduced inertia [{'kg m2' if joint.kind == 'hinge' else 'kg'}]")


def visible_springs(holding: np.ndarray, weight: np.ndarray) -> bool:
    """Tell if the effort that holds weight and springs differs from that for the weight by more than rounding errors."""
    return bool(np.abs(holding - weight).max() > 1e-9 * max(np.abs(holding).max(), np.finfo(float).tiny))


def draw_holding(axes, mechanism: Mechanism, can: Reach) -> None:
    """Draw the effort on the swept coordinate that holds weight and springs, and that for the weight alone if it differs."""
    (x, joint), column = _x(mechanism, can), can.coordinate
    weight = sampled(mechanism.dynamics.gravity_effort, can.poses)[:, column, 0]
    still = np.zeros((len(can.poses), mechanism.dof))
    holding = sampled(mechanism.dynamics.inverse_dynamics, can.poses, still, still)[:, column, 0]
    axes.plot(x, holding, color=BLACK, label="weight and springs")
    sprung = visible_springs(holding, weight)
    if sprung:
        axes.plot(x, weight, color=BLUE, linestyle="--", label="the weight alone")
        outside_legend(axes, narrow=True)
    # The effort grows without bound next to a singular pose: the axis shows the inner 90 % of the samples.
    cut = max(1, len(x) // 20)
    inner = np.concatenate([line[cut:-cut] for line in ((holding, weight) if sprung else (holding,))])
    if len(inner):
        margin = 0.2 * float(np.ptp(inner)) or 1.0
        axes.set_ylim(inner.min() - margin, inner.max() + margin)
    mark_turning(axes, mechanism, can)
    axes.set_xlabel(f"{joint.name} [{joint.unit}]")
    axes.set_ylabel(f"effort that holds it still [{'N.m' if joint.kind == 'hinge' else 'N'}]")
