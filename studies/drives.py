"""What `linkplan check` says of drives that do not do what a model's author may think: one-sided ones, and feeble ones."""

import numpy as np

from models.actuators import Actuator
from models.mechanism import Mechanism
from studies.check_report import effort_unit

# An actuator does not drive a coordinate on which its effort is below this share of the largest: rounding.
NO_ARM = 1e-9
# A weight below this share of what pushes a joint does not bring it back.
_LIGHT = 0.01
# An actuator that has less than this share of what the others give every coordinate it acts on does next to nothing.
_FEEBLE = 1e-3


def pushed_one_way(mechanism: Mechanism, column: int) -> str | None:
    """Return the sentence on an independent joint that actuators only push to one side, with nothing to bring it back."""
    index = int(mechanism.independent[column])
    joint, model = mechanism.joints[index], mechanism.model
    acting = [(a, ends) for a, ends in _efforts(mechanism, column) if ends.any()]
    ends = np.array([ends for _, ends in acting]).reshape(-1, 2)
    if not len(ends) or (np.any(ends[:, 0] < 0) and np.any(ends[:, 1] > 0)):
        return None
    weight = np.abs(np.array(mechanism.dynamics.gravity_effort(mechanism.home))[column]).item()
    if np.any(model.jnt_stiffness) or weight > _LIGHT * np.abs(ends).max():
        return None
    unit, damped = effort_unit(joint), float(model.dof_damping[index]) > 0
    pushes = " and ".join(
        f"{a.name}, on {a.target}, only turns it one way, by {_ends(found)} {unit} at home"
        if joint.kind == "hinge"
        else f"{a.name}, on {a.target}, only pushes it one way, by {_ends(found)} {unit} at home"
        for a, found in acting
    )
    return (
        f"joint {joint.name} moves freely: no actuator is on it{'' if damped else ', nothing damps it'}, no spring or weight"
        f" brings it back; {pushes}"
        if all(a.joint != index for a, _ in acting)
        else f"joint {joint.name} moves freely: {pushes}, and no spring or weight brings it back"
    )


def feeble_drives(mechanism: Mechanism) -> list[str]:
    """Return a sentence on each actuator that, at its limit, adds next to nothing to what others give its coordinates."""
    said = []
    for column, joint in enumerate(mechanism.independent_joints):
        largest = [(a, float(np.abs(ends).max())) for a, ends in _efforts(mechanism, column)]
        strongest, most = max(largest, key=lambda item: item[1], default=(None, 0.0))
        for actuator, own in largest:
            if strongest is not None and np.isfinite(most) and 0 < own < _FEEBLE * most:
                said.append(
                    f"actuator {actuator.name} does next to nothing on joint {joint.name}: at its limit"
                    f" {own:.3g} {effort_unit(joint)} at home, beside {most:.3g} of {strongest.name}"
                )
    return said


def _efforts(mechanism: Mechanism, column: int) -> list[tuple[Actuator, np.ndarray]]:
    """Return each actuator with the least and most effort (2,) that it gives an independent joint at home."""
    arms = np.array(mechanism.dynamics.effort_map(mechanism.home))[column]
    found = []
    for actuator, arm in zip(mechanism.actuators, arms, strict=True):
        acts = abs(arm) > NO_ARM * np.abs(arms).max()
        found.append((actuator, np.sort(arm * np.array([actuator.lower, actuator.upper])) if acts else np.zeros(2)))
    return found


def _ends(ends: np.ndarray) -> str:
    return f"{ends[0] + 0.0:.3g} to {ends[1] + 0.0:.3g}"
