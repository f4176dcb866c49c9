"""Marks of the poses at which a mechanism turns, in the panels of its figures."""

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.reach import Reach, toggles
from linkplan.studies.output.drawing import GREY, RED


def mark_turning(axes, mechanism: Mechanism, can: Reach) -> None:
    """Draw the singular poses of a reach as red dotted lines and the turning points of dependent joints as grey ones."""
    joint = mechanism.joints[mechanism.independent[can.coordinate]]
    left, right = axes.get_xlim()
    labelled = set()
    for words, colour, positions in (
        ("singular pose", RED, can.singular),
        ("a joint turns back", GREY, [position for _, position in toggles(mechanism, can.coordinate)]),
    ):
        for position in positions:
            if left <= joint.shown(position) <= right:  # only one turn of a joint is drawn
                label = None if words in labelled else words
                axes.axvline(joint.shown(position), color=colour, linestyle=":", linewidth=1.2, label=label)
                labelled.add(words)
