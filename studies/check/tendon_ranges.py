"""Poses at which tendons reach the ends of their ranges, and tendons of zero length, whose force has no direction."""

from collections.abc import Sequence
from itertools import pairwise

import mujoco
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled
from linkplan.models.poses.reach import Reach
from linkplan.models.tree.tendons import SITE, is_fixed, lacks_length, path_of, tendon_label

# The fields of MuJoCo's model that make a tendon exert a force.
_PULLS = ("stiffness", "stiffnesspoly", "damping", "dampingpoly", "armature", "frictionloss", "limited")


def tendon_findings(mechanism: Mechanism, reaches: Sequence[Reach]) -> tuple[list[str], list[str]]:
    """Return the sentences on tendons outside their ranges at home, and on positions in the reach at which a range ends.

    Args:
        mechanism: with its tendons' limits.
        reaches: of its independent joints.
    """
    at_home = np.array(mechanism.dynamics.tendon_length(mechanism.home)).ravel()
    problems, notes = [], []
    for item, (tendon, here) in enumerate(zip(mechanism.tendons, at_home, strict=True)):
        said = f"[{tendon.low:g}, {tendon.high:g}] {tendon.unit}".rstrip()
        if not tendon.low <= here <= tendon.high:
            problems.append(
                f"tendon {tendon.name} has the length {here:.4g} at home, outside its range {said}: set another pose by"
                " mechanism.home_deg, or let linkplan.new find one"
            )
            continue
        for can in reaches:
            index = int(mechanism.independent[can.coordinate])
            joint, lengths = mechanism.joints[index], sampled(mechanism.dynamics.tendon_length, can.poses)[:, item, 0]
            stops = [x for end in (tendon.low, tendon.high) for x in _crossings(can.poses[:, index], lengths - end)]
            if stops:
                at = ", ".join(joint.text(x, 4) for x in sorted(stops))
                notes.append(f"tendon {tendon.name} is at the end of its range {said} at {joint.name} = {at} {joint.unit}")
    return problems, notes


def coincident_sites(mechanism: Mechanism) -> list[str]:
    """Return a sentence on each tendon with a force between two sites that coincide at home, to 1e-10 of the extent."""
    model, said = mechanism.model, []
    places = np.array(mechanism.dynamics.site_places(mechanism.home))
    for tendon in filter(lambda tendon: _pulls(model, tendon), range(model.ntendon)):
        path = [int(model.wrap_objid[k]) if int(model.wrap_type[k]) == SITE else None for k in path_of(model, tendon)]
        for one, other in pairwise(path):
            if one is None or other is None or model.site_bodyid[one] == model.site_bodyid[other]:
                continue
            if np.linalg.norm(places[:, one] - places[:, other]) <= 1e-10 * mechanism.extent_m:
                names = " and ".join(model.site(site).name or f"site {site}" for site in (one, other))
                said.append(
                    f"tendon {tendon_label(model, tendon)} has no length between {names}, which coincide at home: its force"
                    " has no direction there (plans assume no force, the simulator the world's x axis); choose another home"
                    " pose, or move one of the sites"
                )
    return said


def _pulls(model: mujoco.MjModel, tendon: int) -> bool:
    """Tell if a tendon through sites exerts a force."""
    kinds, on = model.actuator_trntype, model.actuator_trnid[:, 0]
    driven = np.any((kinds == int(mujoco.mjtTrn.mjTRN_TENDON)) & (on == tendon))
    pulls = driven or any(np.any(getattr(model, f"tendon_{field}")[tendon]) for field in _PULLS)
    return bool(pulls) and not is_fixed(model, tendon) and not lacks_length(model, tendon)


def _crossings(x: np.ndarray, values: np.ndarray) -> list[float]:
    """Return the zeros of values (n,) over x (n,), by linear interpolation."""
    at = np.flatnonzero(values[:-1] * values[1:] < 0)
    return [float(x[k] - values[k] * (x[k + 1] - x[k]) / (values[k + 1] - values[k])) for k in at]
