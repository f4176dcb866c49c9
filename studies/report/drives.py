"""Marks of the actuators in an animation: arcs about axes, arrows along axes, tendons as lines."""

import mujoco
import numpy as np

from linkplan.models.actuation.actuators import Actuator
from linkplan.models.actuation.transmission import TRN_CRANK, TRN_IN_PARENT, TRN_JOINT, TRN_SITE, TRN_TENDON, gear_of
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.tendon_lines import tendon_lines
from linkplan.models.tree.coordinates import HINGE, SLIDE
from linkplan.models.tree.tendons import is_fixed, path_of
from linkplan.studies.output.document import Drive, Mark
from linkplan.studies.output.numbers import rounded


def drives_of(
    mechanism: Mechanism, poses: np.ndarray, effort: np.ndarray, limit: np.ndarray | None, frame: np.ndarray
) -> list[Drive]:
    """Return the actuators of a mechanism at poses (n, n_q), each with its effort and marks.

    Args:
        mechanism: with the actuators.
        poses: (n, n_q).
        effort: (n, n_u) [N.m or N].
        limit: effort limits (n_u, 2); if None, those of the actuators.
        frame: the drawing's directions as rows: right and up in a plane, or all three in space.
    """
    places: list[list] = [[] for _ in mechanism.actuators]
    data = mujoco.MjData(mechanism.model)
    for qpos in mechanism.qpos_of(poses):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(mechanism.model, data)
        mujoco.mj_comPos(mechanism.model, data)
        mujoco.mj_tendon(mechanism.model, data)
        for j, actuator in enumerate(mechanism.actuators):
            places[j].append(_marks(mechanism.model, data, actuator))
    found = []
    for j, actuator in enumerate(mechanism.actuators):
        ends = mechanism.effort_limit[j] if limit is None else limit[j]
        found.append(
            Drive(
                name=actuator.name,
                unit=actuator.unit,
                marks=[mark for k in range(len(places[j][0])) if (mark := _drawn(places[j], k, frame)) is not None],
                effort=rounded(np.nan_to_num(effort[:, j])),
                limits=(_finite(ends[0]), _finite(ends[1])),
            )
        )
    return found


def _finite(end: float) -> float | None:
    return float(end) if np.isfinite(end) else None


def _drawn(places: list, k: int, frame: np.ndarray) -> Mark | None:
    """Return the k-th mark of an actuator over all frames; None for an arc whose axis lies in the plane of the drawing."""
    shape, parts = places[0][k][0], [marks[k][1] for marks in places]
    if shape == "line":  # a tendon has two points more where it touches a geom: elsewhere its last point is repeated
        most = max(len(part) for part in parts)
        lines = np.array([np.pad(part, ((0, most - len(part)), (0, 0)), mode="edge") for part in parts]) @ frame.T
        return Mark(shape=shape, at=rounded(lines.reshape(len(lines), -1)), axis=[])
    at = np.array(parts) @ frame.T
    axis = np.array([marks[k][2] for marks in places])
    if len(frame) == 2 and shape == "arc":
        axis = axis @ np.cross(frame[0], frame[1])[:, None]
        if np.abs(axis).max() < 1e-6:
            return None
    elif len(frame) == 2:
        axis = axis @ frame.T
    return Mark(shape=shape, at=rounded(at), axis=rounded(axis))


def _marks(model: mujoco.MjModel, data: mujoco.MjData, actuator: Actuator) -> list[tuple[str, np.ndarray, np.ndarray]]:
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


def _on_joint(model: mujoco.MjModel, data: mujoco.MjData, joint: int, gear: np.ndarray) -> list:
    anchor, axis = np.array(data.xanchor[joint]), np.array(data.xaxis[joint])
    kind, body = int(model.jnt_type[joint]), int(model.jnt_bodyid[joint])
    if kind == HINGE:
        return [("arc", anchor, np.sign(gear[0]) * axis)]
    if kind == SLIDE:
        return [("arrow", np.array(data.xipos[body]), np.sign(gear[0]) * axis)]
    turned = np.array(data.xmat[body]).reshape(3, 3)
    wrench = gear if gear[3:].any() else np.concatenate([np.zeros(3), gear[:3]])  # a ball's gear is a moment
    return _wrench(anchor, turned, wrench)


def _wrench(at: np.ndarray, turned: np.ndarray, gear: np.ndarray) -> list:
    """Return the marks of a force and a moment, `gear` (6,) in the frame `turned` (3, 3)."""
    force, moment = turned @ gear[:3], turned @ gear[3:]
    shapes = (("arrow", force), ("arc", moment))
    return [(shape, at, axis / np.linalg.norm(axis)) for shape, axis in shapes if np.any(axis)]
