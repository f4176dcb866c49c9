"""Contacts at the operating points of feedback loops: the linear prediction omits their forces, but MuJoCo has them."""

from collections.abc import Sequence

import numpy as np

from linkplan.models.errors import counted, listed
from linkplan.models.poses.contacts import ContactPair, exclusion


def touched(pairs: Sequence[ContactPair], n: int) -> np.ndarray:
    """Return True for each of n loops that has geoms in contact, (n,)."""
    found = np.zeros(n, dtype=bool)
    for pair in pairs:
        found[list(pair.poses)] = True
    return found


def contact_sentence(pairs: Sequence[ContactPair], n: int) -> str | None:
    """Return a sentence on the three deepest contacts at n poses, or None if there is no contact."""
    if not pairs:
        return None
    deepest = sorted(pairs, key=lambda pair: -pair.depth_m)
    named = listed([" and ".join(pair.geoms) for pair in deepest], 3)
    exclusions = " ".join(dict.fromkeys(exclusion(pair.bodies) for pair in deepest[:3]))
    count = int(touched(pairs, n).sum())
    return (
        f"contacts of {named} push in MuJoCo at {count} of {counted(n, 'pose')}, up to"
        f" {1e3 * deepest[0].depth_m:.2g} mm deep; the prediction omits them, they open the kinematic loops, and no response"
        f" is measured there; {exclusions} in the model's <contact> lets links pass side by side"
    )
