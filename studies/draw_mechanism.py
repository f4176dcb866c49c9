"""Figures of a mechanism: the drawing at several poses, and what changes along its reach."""

from pathlib import Path

import numpy as np

from models.along import sampled
from models.assembly import Reach
from models.mechanism import Mechanism
from models.skeleton import sticks
from studies.drawing import BLACK, GREY, RED, SERIES, outside_legend, page
from studies.inspection import Inspection

# An inertia that changes by more than this factor over the reach is drawn on a logarithmic axis.
_LOGARITHMIC = 5.0


def inspection_figure(found: Inspection, path: Path) -> None:
    """Draw the mechanism at five poses of its reach, its dependent joints, reduced inertia and gravity's effort."""
    with page(path, rows=2, columns=2, size=(10.5, 7.5)) as axes:
        draw_mechanism(axes[0, 0], found)
        draw_dependent(axes[0, 1], found)
        draw_inertia(axes[1, 0], found)
        draw_gravity(axes[1, 1], found)
        axes[0, 0].figure.suptitle(found.mechanism.name)


def _shown(found: Inspection) -> tuple[np.ndarray, np.ndarray, object]:
    """Return poses over the first coordinate's reach, that coordinate in its shown unit, and its joint."""
    can = found.reaches[0]
    joint = found.mechanism.joints[found.mechanism.independent[0]]
    position = can.poses[:, found.mechanism.independent[0]]
    return can.poses, np.array([joint.shown(x) for x in position]), joint


def _drawn_reach(found: Inspection) -> np.ndarray:
    """Return the poses of the first coordinate's reach; of one that turns fully, those of most of one turn from home."""
    poses = found.reaches[0].poses
    if not found.reaches[0].turns_fully:
        return poses
    index = found.mechanism.independent[0]
    travel = poses[:, index] - found.mechanism.home[index]
    return poses[(travel >= 0) & (travel <= 1.6 * np.pi)]


def draw_mechanism(axes, found: Inspection) -> None:
    """Draw the bodies as sticks at poses spread over the reach, the home pose strong."""
    poses = _drawn_reach(found)
    chosen = poses[np.linspace(0, len(poses) - 1, 5).astype(int)]
    draw_poses(axes, found.mechanism, np.vstack([chosen, found.mechanism.home]))
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
    axes.set_xlabel("[m]")
    axes.set_ylabel("[m]")


def mark_turning(axes, mechanism: Mechanism, can: Reach) -> None:
    """Draw where a reach is singular, dotted red, and where a dependent joint turns back, dotted grey."""
    joint = mechanism.joints[mechanism.independent[can.coordinate]]
    left, right = axes.get_xlim()
    marks = [(position, RED) for position in can.singular] + [(position, GREY) for _, position in can.toggles]
    for position, colour in marks:
        if left <= joint.shown(position) <= right:  # one turn is drawn of a joint that turns twice
            axes.axvline(joint.shown(position), color=colour, linestyle=":", linewidth=1.2)


def draw_dependent(axes, found: Inspection) -> None:
    """Draw the dependent joints over the independent one, slides on the right; singular poses dotted red, toggles grey."""
    poses, x, joint = _shown(found)
    dependent = [(int(index), found.mechanism.joints[index]) for index in found.mechanism.dependent]
    kinds = list(dict.fromkeys(other.kind for _, other in dependent))
    sides = dict.fromkeys(kinds, axes)
    if len(kinds) == 2:
        sides["slide"] = axes.twinx()
        sides["slide"].grid(visible=False)
        sides["slide"].spines["right"].set_visible(True)
    for k, (index, other) in enumerate(dependent):
        colour = SERIES[k % len(SERIES)]
        sides[other.kind].plot(x, [other.shown(q) for q in poses[:, index]], color=colour)
        axes.plot([], [], color=colour, label=f"{other.name} [{other.unit}]")
    for kind, side in sides.items():
        side.set_ylabel(f"dependent joints [{'deg' if kind == 'hinge' else 'm'}]")
    mark_turning(axes, found.mechanism, found.reaches[0])
    axes.set_xlabel(f"{joint.name} [{joint.unit}]")
    if dependent:
        outside_legend(axes, narrow=True)


def draw_inertia(axes, found: Inspection) -> None:
    """Draw the reduced inertia about the first independent joint, logarithmic where it rises without end."""
    poses, x, joint = _shown(found)
    inertia = sampled(found.mechanism.dynamics.reduced_inertia, poses)[:, 0, 0]
    axes.plot(x, inertia, color=BLACK)
    if inertia.max() > _LOGARITHMIC * inertia.min() > 0:
        axes.set_yscale("log")
    else:
        axes.set_ylim(0.0, 1.2 * inertia.max())
    mark_turning(axes, found.mechanism, found.reaches[0])
    axes.set_xlabel(f"{joint.name} [{joint.unit}]")
    axes.set_ylabel(f"reduced inertia [{'kg m2' if joint.kind == 'hinge' else 'kg'}]")


def draw_gravity(axes, found: Inspection) -> None:
    """Draw the effort on the first independent joint that holds the mechanism's weight."""
    poses, x, joint = _shown(found)
    effort = sampled(found.mechanism.dynamics.gravity_effort, poses)[:, 0, 0]
    axes.plot(x, effort, color=BLACK)
    # Next to a singular pose the effort grows without bound and would hide all else.
    inner = effort[len(effort) // 20 : -max(1, len(effort) // 20)]
    if len(inner):
        margin = 0.2 * np.ptp(inner) + 1e-9
        axes.set_ylim(inner.min() - margin, inner.max() + margin)
    mark_turning(axes, found.mechanism, found.reaches[0])
    axes.set_xlabel(f"{joint.name} [{joint.unit}]")
    axes.set_ylabel(f"effort that holds the weight [{'N.m' if joint.kind == 'hinge' else 'N'}]")
