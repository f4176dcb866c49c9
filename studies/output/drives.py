"""Marks of the actuators in an animation: arcs about axes, arrows along axes, tendons as lines."""

import mujoco
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.studies.output.document import Drive, Mark
from linkplan.studies.output.draw_plan import LEAST_SHOWN
from linkplan.studies.output.effort_marks import effort_marks
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
            places[j].append(effort_marks(mechanism.model, data, actuator))
    found = []
    for j, actuator in enumerate(mechanism.actuators):
        ends = mechanism.effort_limit[j] if limit is None else limit[j]
        found.append(
            Drive(
                name=actuator.name,
                unit=actuator.unit,
                marks=[mark for k in range(len(places[j][0])) if (mark := _drawn(places[j], k, frame)) is not None],
                effort=rounded(np.nan_to_num(np.where(np.abs(effort[:, j]) > LEAST_SHOWN, effort[:, j], 0.0))),
                limits=(_finite(ends[0]), _finite(ends[1])),
            )
        )
    return found


def _finite(end: float) -> float | None:
    return float(end) if np.isfinite(end) else None


def _drawn(places: list, k: int, frame: np.ndarray) -> Mark | None:
    """Return the k-th mark of an actuator over all frames; None for an arc whose axis lies in the plane of the drawing."""
    shape, parts = places[0][k][0], [marks[k][1] for marks in places]
    if shape == "line":  # a tendon has two more points while it touches a geom; otherwise its last point is repeated
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
