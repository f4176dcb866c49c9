"""Figures of a mechanism: the drawing at several poses, and what changes along its reach."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled
from linkplan.models.poses.reach import Reach
from linkplan.models.poses.skeleton import sticks, view
from linkplan.models.tree.joints import Joint
from linkplan.studies.check.inspection import Inspection
from linkplan.studies.output.directions import direction_said
from linkplan.studies.output.drawing import BLACK, BLUE, GREY, RED, SERIES, STYLES, outside_legend, page

# An inertia that changes by more than this factor over the reach is drawn on a logarithmic axis.
_LOGARITHMIC = 5.0
# Coordinates of which the sweep is drawn: more would make a page that nobody looks at. Each has loop-N.png of its own.
_DRAWN = 3
# Springs that take less than this share of the weight are not drawn beside it: rounding.
_NOTHING = 1e-9


def inspection_figure(found: Inspection, path: Path | None = None) -> Figure:
    """Return the figure of a mechanism over each coordinate's reach, saved at `path` where one is given.

    Drawn are the mechanism, its dependent joints, the reduced inertia, and the effort that holds it.
    """
    reaches, mechanism = found.reaches[:_DRAWN], found.mechanism
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
    """Return the swept coordinate at a reach's poses in its shown unit, and its joint."""
    index = mechanism.independent[can.coordinate]
    joint = mechanism.joints[index]
    return np.array([joint.shown(x) for x in can.poses[:, index]]), joint


def _drawn_reach(mechanism: Mechanism, can: Reach) -> np.ndarray:
    """Return the poses of a reach; of one that turns fully, those of most of one turn from home."""
    if not can.turns_fully:
        return can.poses
    index = mechanism.independent[can.coordinate]
    travel = can.poses[:, index] - mechanism.home[index]
    return can.poses[(travel >= 0) & (travel <= 1.6 * np.pi)]


def draw_mechanism(axes, mechanism: Mechanism, can: Reach) -> None:
    """Draw the bodies as sticks at poses spread over a reach, the home pose strong."""
    poses = _drawn_reach(mechanism, can)
    chosen = poses[np.linspace(0, len(poses) - 1, 5).astype(int)]
    draw_poses(axes, mechanism, np.vstack([chosen, mechanism.home]))
    outside_legend(axes, narrow=True, fontsize=8)


def draw_poses(axes, mechanism: Mechanism, poses: np.ndarray) -> None:
    """Draw the bodies as sticks at poses (n, n_q), the last one strong."""
    colours = iter(SERIES * 10)
    for depth, stick in enumerate(sticks(mechanism, poses)):
        colour = GREY if stick.fixed else next(colours)
        for k, pins in enumerate(stick.pins):  # a body lies over those that it carries
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
    right, up = (direction_said(direction) for direction in view(mechanism.model))
    axes.set_xlabel(f"{right} [m]")
    axes.set_ylabel(f"{up} [m]")


def mark_turning(axes, mechanism: Mechanism, can: Reach, *, named: bool = False) -> None:
    """Draw where a reach is singular, dotted red, and where a dependent joint turns back, dotted grey."""
    joint = mechanism.joints[mechanism.independent[can.coordinate]]
    left, right = axes.get_xlim()
    told = set()
    for words, colour, positions in (
        ("singular pose", RED, can.singular),
        ("a joint turns back", GREY, [position for _, position in can.toggles]),
    ):
        for position in positions:
            if left <= joint.shown(position) <= right:  # one turn is drawn of a joint that turns twice
                label = words if named and words not in told else None
                axes.axvline(joint.shown(position), color=colour, linestyle=":", linewidth=1.2, label=label)
                told.add(words)


def draw_dependent(axes, mechanism: Mechanism, can: Reach) -> None:
    """Draw the dependent joints over the swept one, slides on the right; singular poses dotted red, toggles grey."""
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
    """Draw the reduced inertia along the swept coordinate, logarithmic where it rises without end."""
    (x, joint), column = _x(mechanism, can), can.coordinate
    inertia = sampled(mechanism.dynamics.reduced_inertia, can.poses)[:, column, column]
    axes.plot(x, inertia, color=BLACK)
    if inertia.max() > _LOGARITHMIC * inertia.min() > 0:
        axes.set_yscale("log")
    else:
        axes.set_ylim(0.0, 1.2 * inertia.max())
    mark_turning(axes, mechanism, can)
    axes.set_xlabel(f"{joint.name} [{joint.unit}]")
    axes.set_ylabel(f"reduced inertia [{'kg m2' if joint.kind == 'hinge' else 'kg'}]")


def draw_holding(axes, mechanism: Mechanism, can: Reach) -> None:
    """Draw the effort on the swept coordinate that holds weight and springs, and the weight's own where they differ."""
    (x, joint), column = _x(mechanism, can), can.coordinate
    weight = sampled(mechanism.dynamics.gravity_effort, can.poses)[:, column, 0]
    still = np.zeros((len(can.poses), mechanism.dof))
    holding = sampled(mechanism.dynamics.inverse_dynamics, can.poses, still, still)[:, column, 0]
    axes.plot(x, holding, color=BLACK, label="weight and springs")
    sprung = np.abs(holding - weight).max() > _NOTHING * max(np.abs(weight).max(), np.finfo(float).tiny)
    if sprung:
        axes.plot(x, weight, color=BLUE, linestyle="--", label="the weight alone")
        outside_legend(axes, narrow=True)
    # Next to a singular pose the effort grows without bound and would hide all else.
    cut = max(1, len(x) // 20)
    inner = np.concatenate([line[cut:-cut] for line in ((holding, weight) if sprung else (holding,))])
    if len(inner):
        margin = 0.2 * float(np.ptp(inner)) or 1.0
        axes.set_ylim(inner.min() - margin, inner.max() + margin)
    mark_turning(axes, mechanism, can)
    axes.set_xlabel(f"{joint.name} [{joint.unit}]")
    axes.set_ylabel(f"effort that holds it still [{'N.m' if joint.kind == 'hinge' else 'N'}]")
