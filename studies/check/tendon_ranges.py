"""Where tendons reach the ends of their ranges."""

from collections.abc import Sequence

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled
from linkplan.models.poses.reach import Reach


def tendon_findings(mechanism: Mechanism, reaches: Sequence[Reach]) -> tuple[list[str], list[str]]:
    """Return the sentences on tendons that are beyond their ranges at home, and on where in a reach they stop the mechanism.

    Args:
        mechanism: with its tendons' limits.
        reaches: of its independent joints.
    """
    at_home = np.array(mechanism.dynamics.tendon_length(mechanism.home)).ravel()
    problems, notes = [], []
    for item, (tendon, here) in enumerate(zip(mechanism.tendons, at_home, strict=True)):
        said = f"[{tendon.low:g}, {tendon.high:g}] {tendon.unit}".rstrip()
        if not tendon.low <= here <= tendon.high:
            problems.append(f"tendon {tendon.name} has the length {here:.4g} at home, outside its range {said}")
            continue
        for can in reaches:
            index = int(mechanism.independent[can.coordinate])
            joint, lengths = mechanism.joints[index], sampled(mechanism.dynamics.tendon_length, can.poses)[:, item, 0]
            stops = [x for end in (tendon.low, tendon.high) for x in _crossings(can.poses[:, index], lengths - end)]
            if stops:
                at = ", ".join(joint.said(x, 4) for x in sorted(stops))
                notes.append(f"tendon {tendon.name} is at the end of its range {said} at {joint.name} = {at} {joint.unit}")
    return problems, notes


def _crossings(x: np.ndarray, values: np.ndarray) -> list[float]:
    """Return where values (n,) over x (n,) change sign, on straight lines between samples."""
    at = np.flatnonzero(values[:-1] * values[1:] < 0)
    return [float(x[k] - values[k] * (x[k + 1] - x[k]) / (values[k + 1] - values[k])) for k in at]
