"""A stick drawing of a mechanism, with each body as the polygon of its pins, and the lines along which tendons run."""

import itertools
from dataclasses import dataclass

import mujoco
import numpy as np

from linkplan.models.kinematics import data_at, fields_at, joints_of, tied_points
from linkplan.models.mechanism import Mechanism
from linkplan.models.tree.coordinates import BALL, FREE, SLIDE

# MuJoCo's value of `wrap_obj` for a pulley, which has no place.
_PULLEY_OBJECT = -2


def tendon_lines(data: mujoco.MjData, tendon: int) -> list[np.ndarray]:
    """Return the points (n, 3) [m] of a spatial tendon's branches, after `mj_tendon`."""
    first, n = int(data.ten_wrapadr[tendon]), int(data.ten_wrapnum[tendon])
    points = np.array(data.wrap_xpos).reshape(-1, 3)[first : first + n]
    pulleys = np.flatnonzero(np.array(data.wrap_obj).ravel()[first : first + n] == _PULLEY_OBJECT)
    ends = [-1, *pulleys.tolist(), n]
    return [points[a + 1 : b] for a, b in itertools.pairwise(ends) if b - a > 2]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Stick:
    """One body with its pins at n poses [m]: `pins` (n, n_pins, 2) in the drawing, `places` (n, n_pins, 3) in the world."""

    body: str
    fixed: bool
    pins: np.ndarray
    places: np.ndarray


def sticks(mechanism: Mechanism, poses: np.ndarray) -> tuple[Stick, ...]:
    """Return the bodies of a mechanism at poses (n, n_q), viewed along the axis that most hinges share."""
    right, up = view(mechanism.model)
    return tuple(
        Stick(
            body=body_name(mechanism.model, body),
            fixed=body == 0,
            pins=np.stack([points @ right, points @ up], axis=-1),
            places=points,
        )
        for body, points in pins_in_space(mechanism, poses).items()
    )


def pins_in_space(mechanism: Mechanism, poses: np.ndarray) -> dict[int, np.ndarray]:
    """Return the positions (n, n_pins, 3) [m] of each body's pins at poses (n, n_q), by MuJoCo's index of the body.

    A body's pins are its own joint's anchor, its children's anchors and the points where closures tie it. A body that slides
    in a moving body is drawn from that body's own pin. A body with a single pin is drawn to its centre of mass.
    """
    places, turns = fields_at(mechanism.model, mechanism.qpos_of(poses), "xpos", "xmat")
    turns = turns.reshape(len(poses), -1, 3, 3)
    return {
        body: np.stack([places[:, on] + turns[:, on] @ point for on, point in pins], axis=1)
        for body, pins in sorted(_pins(mechanism.model).items())
    }


def _pins(model: mujoco.MjModel) -> dict[int, list[tuple[int, np.ndarray]]]:
    """Return each body's pins: a body and a position (3,) [m] in its frame."""
    pins: dict[int, list[tuple[int, np.ndarray]]] = {}
    for body in range(1, model.nbody):
        for joint in joints_of(model, body):
            anchor = (body, model.jnt_pos[joint])
            pins.setdefault(body, []).append(anchor)
            if model.jnt_type[joint] == FREE:
                continue
            parent = int(model.body_parentid[body])
            carrier = int(model.body_weldid[parent])  # the nearest ancestor with a joint, or the world
            if model.jnt_type[joint] != SLIDE:
                pins.setdefault(carrier, []).append(anchor)
            elif carrier == 0:
                # A slide's own anchor moves with it. The ground's pin is the anchor at the joint's reference.
                pins.setdefault(0, []).append((parent, model.body_pos[body]))
            else:
                pins[body].insert(0, pins[carrier][0])
    for index in range(model.neq):
        if not model.eq_active0[index]:
            continue
        for body, point in tied_points(model, index):
            pins.setdefault(int(model.body_weldid[body]), []).append((body, point))
    for body, points in pins.items():
        if len(points) == 1 and body != 0:
            points.append((body, model.body_ipos[body]))
    return pins


def body_name(model: mujoco.MjModel, body: int) -> str:
    """Return the name of the stick that contains a body."""
    body = int(model.body_weldid[body])
    return "ground" if body == 0 else model.body(body).name


def view(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Return the drawing's right and up directions (3,), normal to the hinges' common axis, with up near +z."""
    axes = np.array(data_at(model).xaxis[~np.isin(model.jnt_type, (SLIDE, BALL, FREE))]).reshape(-1, 3)
    normal = np.array([0.0, 1.0, 0.0])
    if len(axes):
        normal = np.linalg.svd(axes)[2][0]
        normal = normal * np.sign(normal[np.argmax(np.abs(normal))])
    up = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
    if np.linalg.norm(up) < 0.1:
        up = np.array([0.0, 1.0, 0.0]) - normal[1] * normal
        up /= np.linalg.norm(up)
        return np.cross(up, normal), up
    up /= np.linalg.norm(up)
    # Viewed along +y, +x points right if +z points up.
    return np.cross(normal, up), up
