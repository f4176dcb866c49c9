"""Panels of a mechanism's figures: its bodies as sticks at several poses, and marks of the poses at which it turns."""

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.reach import Reach
from linkplan.models.poses.skeleton import sticks, view
from linkplan.studies.output.directions import direction_name
from linkplan.studies.output.drawing import GREY, RED, SERIES

# A larger legend would leave no space for the lines.
_MAX_LEGEND_ENTRIES = 12


def draw_poses(axes, mechanism: Mechanism, poses: np.ndarray) -> None:
    """Draw the bodies as sticks at poses (n, n_q); the last one is opaque."""
    colours, drawn = iter(SERIES * 10), sticks(mechanism, poses)
    named = len(drawn) <= _MAX_LEGEND_ENTRIES
    for depth, stick in enumerate(drawn):
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
                label=stick.body if last and named else None,
            )
    axes.set_aspect("equal", adjustable="datalim")
    axes.locator_params(axis="x", nbins=6)
    right, up = (direction_name(direction) for direction in view(mechanism.model))
    axes.set_xlabel(f"{right} [m]")
    axes.set_ylabel(f"{up} [m]")


def mark_turning(axes, mechanism: Mechanism, can: Reach) -> None:
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
                label = None if words in labelled else words
                axes.axvline(joint.shown(position), color=colour, linestyle=":", linewidth=1.2, label=label)
                labelled.add(words)
