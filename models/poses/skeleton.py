"""A stick drawing of a mechanism: each body as the polygon of its pins."""

import functools
from dataclasses import dataclass

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.kinematics import data_at
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled
from linkplan.models.ties import tied_points
from linkplan.models.tree.coordinates import BALL, FREE, SLIDE
from linkplan.models.tree.dynamics import build_tree


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
    function, columns = _pins(mechanism)
    places = sampled(function, poses).transpose(0, 2, 1)
    return {body: places[:, of] for body, of in columns.items()}


@functools.lru_cache(maxsize=8)
def _pins(mechanism: Mechanism) -> tuple[ca.Function, dict[int, slice]]:
    """Return the function from q to all pins (3, n_pins), and each body's columns of it."""
    model = mechanism.model
    tree = build_tree(model, mechanism.qpos_of(mechanism.reference))
    pins: dict[int, list[ca.SX]] = {}
    for body in range(1, model.nbody):
        for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            anchor = tree.point(body, model.jnt_pos[joint])
            pins.setdefault(body, []).append(anchor)
            if model.jnt_type[joint] == FREE:
                continue
            parent = int(model.body_parentid[body])
            if model.jnt_type[joint] != SLIDE:
                pins.setdefault(_solid(model, parent), []).append(anchor)
            elif _solid(model, parent) == 0:
                # A slide's own anchor moves with it. The ground's pin is the anchor at the joint's reference.
                pins.setdefault(0, []).append(tree.point(parent, np.array(model.body_pos[body])))
            else:
                pins[body].insert(0, pins[_solid(model, parent)][0])
    for index in range(model.neq):
        if not model.eq_active0[index]:
            continue
        for body, point in tied_points(model, index):
            pins.setdefault(_solid(model, body), []).append(tree.point(body, point))
    for body, points in pins.items():
        if len(points) == 1 and body != 0:
            points.append(tree.point(body, np.array(model.body_ipos[body])))
    columns, begin = {}, 0
    for body in sorted(pins):
        columns[body] = slice(begin, begin := begin + len(pins[body]))
    places = [point for body in columns for point in pins[body]]
    return ca.Function("pins", [tree.q], [ca.densify(ca.horzcat(*places))]), columns


def _solid(model: mujoco.MjModel, body: int) -> int:
    """Return the root of the rigid group of a body: the nearest ancestor with a joint, or the world (0)."""
    return int(model.body_weldid[body])


def body_name(model: mujoco.MjModel, body: int) -> str:
    """Return the name of the stick that contains a body."""
    body = _solid(model, body)
    return "ground" if body == 0 else model.body(body).name or f"body {body}"


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
