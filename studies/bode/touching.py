"""Contacts that push where a feedback loop is held: forces that its prediction leaves out, and a measurement would show."""

from collections.abc import Sequence

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.contacts import ContactPair, contact_pairs, exclusion
from linkplan.studies.frequency.feedback_loops import FeedbackLoop

# Pairs of geoms that are named.
_NAMED = 3


def touching(mechanism: Mechanism, loops: Sequence[FeedbackLoop]) -> tuple[ContactPair, ...]:
    """Return the pairs of geoms in contact where loops are held, each with the indices of those loops."""
    return contact_pairs(mechanism, np.array([loop.point.pose for loop in loops]))


def touched(pairs: Sequence[ContactPair], n: int) -> np.ndarray:
    """Return at which of n loops some geoms are in contact (n,)."""
    found = np.zeros(n, dtype=bool)
    for pair in pairs:
        found[list(pair.poses)] = True
    return found


def contact_sentence(pairs: Sequence[ContactPair], n: int) -> str | None:
    """Return the sentence on contacts at some of n poses that are held, None where there are none."""
    if not pairs:
        return None
    deepest = sorted(pairs, key=lambda pair: -pair.depth_m)
    named = ", ".join(f"{pair.first} and {pair.second}" for pair in deepest[:_NAMED])
    more = f" and {len(pairs) - _NAMED} more pairs" if len(pairs) > _NAMED else ""
    told = " ".join(dict.fromkeys(exclusion(pair.bodies) for pair in deepest[:_NAMED]))
    count = int(touched(pairs, n).sum())
    return (
        f"contacts of {named}{more} push in MuJoCo at {count} of {n} pose{'s' if n != 1 else ''}, up to"
        f" {1e3 * deepest[0].depth_m:.2g} mm deep; the prediction leaves them out, loops gape where their links push each"
        f" other, and no response is measured there; {told} in the model's <contact> lets links pass side by side"
    )
