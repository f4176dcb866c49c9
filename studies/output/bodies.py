"""The bodies of an animation: pins, solid shapes and sites, in the mechanism's plane or in space."""

import functools
from dataclasses import dataclass

import mujoco
import numpy as np

from linkplan.models.kinematics import data_at
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.skeleton import Stick, body_name, sticks
from linkplan.models.poses.solids import Solid, body_frames, cut_pins, faces, outline, solids, visible_sites
from linkplan.models.tree.coordinates import joint_label
from linkplan.studies.output.body_colours import body_colours, colour_name
from linkplan.studies.output.document import Body, Numbers, Shape
from linkplan.studies.output.numbers import rounded

# The largest relative deviation of pins' depths and of bodies' axes from a motion in parallel planes.
_FLAT_SHARE = 1e-6


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Drawing:
    """How a mechanism is drawn: `frame` has the directions as rows, two in a plane or all three in space.

    `turns` (n_body, 3, 3) are the bodies' rotations for which flat shapes are drawn. `still` (n_body,) marks bodies at rest.
    """

    mechanism: Mechanism
    frame: np.ndarray
    turns: np.ndarray
    shapes: tuple[Solid, ...]

    @property
    def flat(self) -> bool:
        """Whether the drawing is in a plane."""
        return len(self.frame) == 2


def drawing_of(mechanism: Mechanism, poses: np.ndarray, plane: tuple[np.ndarray, np.ndarray]) -> Drawing:
    """Return the drawing of a mechanism along poses (n, n_q): in the plane (right, up) if all bodies move parallel to it."""
    across = np.cross(*plane)
    _, turns = body_frames(mechanism, poses)
    moving = np.flatnonzero(mechanism.model.body_weldid != 0)
    axes = np.einsum("nbij,i->nbj", turns[:, moving], across)  # the plane's normal in the frames of the bodies
    parallel = float(np.abs(axes - axes[:1]).max(initial=0.0)) <= _FLAT_SHARE
    depths = [float(np.ptp(stick.places @ across, axis=0).max()) for stick in sticks(mechanism, poses)]
    flat = parallel and max(depths, default=0.0) <= _FLAT_SHARE * mechanism.extent_m
    frame = np.stack(plane) if flat else np.eye(3)
    return Drawing(mechanism=mechanism, frame=frame, turns=turns[0], shapes=solids(mechanism))


def bodies_of(drawing: Drawing, poses: np.ndarray, *, shaped: bool = True) -> list[Body]:
    """Return the bodies of a drawing at poses (n, n_q), with shapes and sites if `shaped`."""
    mechanism, model = drawing.mechanism, drawing.mechanism.model
    places, turns = body_frames(mechanism, poses)
    drawn = {stick.body: stick for stick in sticks(mechanism, poses)}
    roots = sorted({int(root) for root in model.body_weldid if _is_drawn(drawing, int(root), drawn)})
    found, colours = [], body_colours(mechanism)
    for root in roots:
        name = body_name(model, root)
        pins = np.zeros((len(poses), 0, 3)) if name not in drawn else drawn[name].places
        own = [solid for solid in drawing.shapes if solid.body == root] if shaped else []
        found.append(
            Body(
                name=name,
                fixed=root == 0,
                colour=colour_name(colours[root]) if root else "",
                n_pins=pins.shape[1],
                points=rounded((pins @ drawing.frame.T).reshape(len(poses), -1)),
                places=_places(drawing, root, places[:, root], turns[:, root]),
                shapes=[_shape(drawing, solid) for solid in own],
                sites=_sites(drawing, root) if shaped else [],
                depth=_depth(drawing, own, pins),
            )
        )
    return found


def _is_drawn(drawing: Drawing, root: int, drawn: dict[str, Stick]) -> bool:
    return body_name(drawing.mechanism.model, root) in drawn or any(solid.body == root for solid in drawing.shapes)


def _places(drawing: Drawing, root: int, places: np.ndarray, turns: np.ndarray) -> list[list]:
    """Return a body's frame at every pose: position, then cosine and sine of its angle, or its quaternion."""
    at = rounded(places @ drawing.frame.T, digits=6)
    if drawing.flat:
        right, up = drawing.frame
        first = drawing.turns[root].T @ right
        angle = np.stack([turns @ first @ right, turns @ first @ up], axis=1)
    else:
        angle = np.empty((len(turns), 4))
        for k, turn in enumerate(turns):
            mujoco.mju_mat2Quat(angle[k], turn.ravel())
            if k and angle[k] @ angle[k - 1] < 0:
                angle[k] *= -1
    rows = [[*place, *turned] for place, turned in zip(at, rounded(angle, digits=6), strict=True)]
    return rows[:1] if root == 0 else rows


def _flattened(drawing: Drawing, body: int, points: np.ndarray) -> np.ndarray:
    """Return points (n, 3) of a body's frame in the drawing's frame; in a plane, (n, 2)."""
    return points @ (drawing.frame @ drawing.turns[body]).T if drawing.flat else points


def _shape(drawing: Drawing, solid: Solid) -> Shape:
    points = _flattened(drawing, solid.body, solid.points)
    if drawing.flat:
        return Shape(points=rounded(outline(points).reshape(1, -1))[0], radius=solid.radius, look=solid.kind)
    return Shape(points=rounded(points.reshape(1, -1))[0], radius=solid.radius, faces=_faces(solid), look=solid.kind)


@functools.lru_cache(maxsize=1024)
def _faces(solid: Solid) -> list[list[int]]:
    """Return the faces of a solid, the same for all animations of a page."""
    return faces(solid.points)


@functools.lru_cache(maxsize=8)
def _at_home(mechanism: Mechanism) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the bodies' places (n_body, 3) and rotations (n_body, 3, 3) at home, and the pins' places (n, 3)."""
    places, turns = body_frames(mechanism, mechanism.home[None])
    anchors = [stick.places[0] for stick in sticks(mechanism, mechanism.home[None])]
    return places[0], turns[0], np.vstack(anchors or [np.zeros((0, 3))])


def _sites(drawing: Drawing, root: int) -> list[tuple[str, Numbers]]:
    """Return the sites of a body that do not coincide with its pins."""
    mechanism = drawing.mechanism
    places, turns, anchors = _at_home(mechanism)
    found = []
    for site in visible_sites(mechanism):
        place = places[site.body] + turns[site.body] @ site.point
        if site.body == root and np.linalg.norm(anchors - place, axis=1).min(initial=np.inf) > 1e-4 * mechanism.extent_m:
            found.append((site.name, rounded(_flattened(drawing, root, site.point[None]))[0]))
    return found


def _depth(drawing: Drawing, own: list[Solid], pins: np.ndarray) -> float:
    """Return the depth of a body, which is larger near the eye: the mean over its shapes, or over its pins [m]."""
    if not drawing.flat:
        return 0.0
    towards = np.cross(*drawing.frame)
    if not own:
        return float(np.mean(pins @ towards)) if pins.size else 0.0
    places, turns, _ = _at_home(drawing.mechanism)
    depths = [
        np.mean((places[solid.body] + solid.points @ turns[solid.body].T) @ towards) for solid in own if solid.kind == "geom"
    ]
    return float(f"{np.mean(depths) if depths else 0.0:.4g}")


def named_pins(mechanism: Mechanism, poses: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Return the names of joints and of the pins that close loops, each with its positions (n, 3) [m] at poses (n, n_q)."""
    model = mechanism.model
    joints = [(joint_label(model, k), int(model.jnt_bodyid[k]), model.jnt_pos[k]) for k in range(model.njnt)]
    cut = [(pin.name, pin.body, pin.point) for pin in cut_pins(mechanism)]
    places, turns = body_frames(mechanism, poses)
    return [(name, places[:, body] + turns[:, body] @ point) for name, body, point in (*joints, *cut)]


def floors_of(mechanism: Mechanism) -> list[float]:
    """Return the heights [m] of the ground's horizontal planes that the mechanism comes near."""
    model = mechanism.model
    data = data_at(model, mechanism.qpos_of(mechanism.home))
    fixed = model.body_weldid[model.geom_bodyid] == 0
    planes = np.flatnonzero(fixed & (model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)))
    level = [k for k in planes if abs(data.geom_xmat[k].reshape(3, 3)[2, 2]) > 1 - 1e-9]
    return sorted({float(f"{data.geom_xpos[k][2]:.6g}") for k in level})
