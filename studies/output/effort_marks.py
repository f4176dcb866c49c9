"""The marks of an actuator's effort at a pose: arcs about axes, arrows along axes, tendons as lines."""

import mujoco
import numpy as np

from linkplan.models.actuation.actuators import Actuator
from linkplan.models.actuation.transmission import TRN_CRANK, TRN_IN_PARENT, TRN_JOINT, TRN_SITE, TRN_TENDON, gear_of
from linkplan.models.poses.skeleton import tendon_lines
from linkplan.models.tree.coordinates import HINGE, SLIDE
from linkplan.models.tree.tendons import is_fixed, path_of

EffortMark = tuple[str, np.ndarray, np.ndarray]


def effort_marks(model: mujoco.MjModel, data: mujoco.MjData, actuator: Actuator) -> list[EffortMark]:
    """Return an actuator's marks at the current pose: shape, position (3,) or (n, 3), direction (3,) of a positive effort.

    A tendon through sites is a line: its force pulls its ends together.
    """
    kind, (on, other) = int(model.actuator_trntype[actuator.index]), (int(i) for i in model.actuator_trnid[actuator.index])
    gear = gear_of(model, actuator.index)
    if kind in (TRN_JOINT, TRN_IN_PARENT):
        return _on_joint(model, data, on, gear)
    if kind == TRN_TENDON and is_fixed(model, on):
        wraps = [(int(model.wrap_objid[k]), gear * float(np.sign(model.wrap_prm[k]))) for k in path_of(model, on)]
        return [mark for joint, pull in wraps for mark in _on_joint(model, data, joint, pull)]
    if kind == TRN_TENDON:
        return [("line", part, np.zeros(3)) for part in tendon_lines(data, on)]
    if kind == TRN_CRANK:  # along the slider's axis, which is its site's z
        axis = np.array(data.site_xmat[other]).reshape(3, 3)[:, 2] * np.sign(gear[0])
        return [("arrow", np.array(data.site_xpos[other]), axis)]
    if kind == TRN_SITE:
        turned = np.array(data.site_xmat[on if other < 0 else other]).reshape(3, 3)
        return _wrench(np.array(data.site_xpos[on]), turned, gear)
    return []


def _on_joint(model: mujoco.MjModel, data: mujoco.MjData, joint: int, gear: np.ndarray) -> list[EffortMark]:
    anchor, axis = np.array(data.xanchor[joint]), np.array(data.xaxis[joint])
    kind, body = int(model.jnt_type[joint]), int(model.jnt_bodyid[joint])
    if kind == HINGE:
        return [("arc", anchor, np.sign(gear[0]) * axis)]
    if kind == SLIDE:
        return [("arrow", np.array(data.xipos[body]), np.sign(gear[0]) * axis)]
    turned = np.array(data.xmat[body]).reshape(3, 3)
    wrench = gear if gear[3:].any() else np.concatenate([np.zeros(3), gear[:3]])  # the gear of a ball joint is a moment
    return _wrench(anchor, turned, wrench)


def _wrench(at: np.ndarray, turned: np.ndarray, gear: np.ndarray) -> list[EffortMark]:
    """Return the marks of a force and a moment, `gear` (6,) in the frame `turned` (3, 3)."""
    force, moment = turned @ gear[:3], turned @ gear[3:]
    shapes = (("arrow", force), ("arc", moment))
    return [(shape, at, axis / np.linalg.norm(axis)) for shape, axis in shapes if np.any(axis)]
