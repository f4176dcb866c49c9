"""The solid shapes of a mechanism's bodies, each convex and in its body's frame, and convex hulls for drawings.

Shapes are visible geoms, a payload, and arms to sites.
"""

import functools
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from linkplan.models.kinematics import data_at, fields_at, tied_points
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.skeleton import pins_in_space
from linkplan.models.tree.coordinates import rotation_from_quaternion

_SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


def simplified(vertices: np.ndarray) -> np.ndarray:
    """Return at most 120 of the vertices (n, 3): the corners of the hull, or the furthest in evenly spread directions."""
    try:
        corners = vertices[ConvexHull(vertices).vertices]
    except QhullError:  # a flat mesh has no volume
        corners = vertices
    if len(corners) <= 120:
        return corners
    return corners[np.unique(np.argmax(corners @ directions(120).T, axis=0))]


@functools.cache
def directions(n: int) -> np.ndarray:
    """Return n unit vectors (n, 3), evenly spread by the golden angle."""
    k = np.arange(n) + 0.5
    z, angle = 1.0 - 2.0 * k / n, np.pi * (3.0 - np.sqrt(5.0)) * k
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


def outline(points: np.ndarray) -> np.ndarray:
    """Return the corners (m, 2) of the convex hull of points (n, 2), in their order around it."""
    try:
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError):  # all points on one line: its two ends, or a single point
        span = points - points[0]
        along = span @ span[int(np.argmax((span**2).sum(axis=1)))]
        ends = points[[int(np.argmin(along)), int(np.argmax(along))]]
        return ends if np.ptp(ends, axis=0).any() else ends[:1]


def thickened(points: np.ndarray, radius: float) -> np.ndarray:
    """Return points (n, 2) or, for a positive radius, points on the circles of this radius around them."""
    if radius == 0:
        return points
    angle = np.linspace(0.0, 2 * np.pi, 28, endpoint=False)
    circle = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return (points[:, None] + circle).reshape(-1, 2)


def faces(points: np.ndarray) -> list[list[int]]:
    """Return the faces of the convex hull of points (n, 3): indices of corners, counterclockwise seen from outside.

    Triangles in one plane are joined to one face. Points in one plane have a single face; points on one line have none.
    """
    if len(points) < 3:
        return []
    middle = points.mean(axis=0)
    try:
        hull = ConvexHull(points)
    except QhullError:
        normal = np.linalg.svd(points - middle)[2][2]
        return [_around(points, np.arange(len(points)), normal)]
    scale = float(np.abs(points - middle).max())
    normals, distances = hull.equations[:, :3], hull.equations[:, 3] + hull.equations[:, :3] @ middle
    corners = hull.simplices
    first, second, third = (points[corners[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(second - first, third - first), normals) < 0
    triangles = np.where(inward[:, None], corners[:, ::-1], corners)
    planes: dict[tuple, list[int]] = {}
    for k, key in enumerate(map(tuple, np.round(np.column_stack([normals, distances / scale]), 5).tolist())):
        planes.setdefault(key, []).append(k)
    return [
        triangles[own[0]].tolist() if len(own) == 1 else _around(points, np.unique(triangles[own]), np.array(key[:3]))
        for key, own in planes.items()
    ]


def _around(points: np.ndarray, corners: np.ndarray, normal: np.ndarray) -> list[int]:
    """Return the corners in their order around a normal (3,)."""
    spokes = points[corners] - points[corners].mean(axis=0)
    first = spokes[int(np.argmax((spokes**2).sum(axis=1)))]
    angle = np.arctan2(spokes @ np.cross(normal, first), spokes @ first)
    return corners[np.argsort(angle)].tolist()


_SPHERE, _CAPSULE, _ELLIPSOID, _CYLINDER, _BOX, _MESH = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}")) for name in ("SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX", "MESH")
)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Solid:
    """A convex shape of a body: the hull of `points` (n, 3) [m] in the body's frame, thickened by `radius` [m].

    A sphere is one point and a capsule two points, both with a radius. `body` is MuJoCo's index of the root of the rigid
    group, 0 for the ground. `kind` is "geom", "payload", or "arm" for a thin line from a pin to a site or a payload.
    """

    body: int
    points: np.ndarray
    radius: float = 0.0
    kind: str = "geom"


def visible_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Return the mask (n_geom,) of visible geoms: neither transparent nor in groups that MuJoCo's viewer hides."""
    matte = np.where(model.geom_matid >= 0, 1.0, model.geom_rgba[:, 3])
    return (matte > 0) & (model.geom_group < 3)


@functools.lru_cache(maxsize=8)
def solids(mechanism: Mechanism) -> tuple[Solid, ...]:
    """Return the shapes of a mechanism: its geoms, its payload, and arms to the sites of bodies without geoms."""
    found = geom_solids(mechanism)
    rod = payload_rod(mechanism)
    return (*found, *([] if rod is None else [rod]), *_arms(mechanism, {solid.body for solid in found}, rod))


def geom_solids(mechanism: Mechanism) -> tuple[Solid, ...]:
    """Return the shapes of all visible geoms except planes, height fields, and scenery.

    A mesh is simplified to its convex hull, with at most 120 vertices. Geoms of the ground are scenery if they reach farther
    than two of the mechanism's extents from its middle.
    """
    model = mechanism.model
    data = data_at(model, mechanism.qpos_of(mechanism.home))
    found, middle = [], data.xpos[1:].mean(axis=0)
    farthest = np.linalg.norm(data.geom_xpos - middle, axis=1) + model.geom_rbound
    scenery = (model.body_weldid[model.geom_bodyid] == 0) & (farthest > 2.0 * mechanism.extent_m)
    for geom in np.flatnonzero(visible_geoms(model) & ~scenery):
        shape = _shape_of(model, int(geom))
        if shape is not None:
            points, radius = shape
            body = int(model.body_weldid[model.geom_bodyid[geom]])
            turn, place = np.array(data.geom_xmat[geom]).reshape(3, 3), np.array(data.geom_xpos[geom])
            root = np.array(data.xmat[body]).reshape(3, 3)
            found.append(Solid(body=body, points=(points @ turn.T + place - data.xpos[body]) @ root, radius=radius))
    return tuple(found)


def payload_rod(mechanism: Mechanism) -> Solid | None:
    """Return the payload as a thin rod along the line from its body's joint to its centre of mass; None without a payload.

    The rod's length is that of the uniform rod of the same mass and largest moment of inertia, L = sqrt(12 I / m). A payload
    without inertia, or with its centre of mass at the joint, is a ball.
    """
    payload = mechanism.payload
    if payload is None:
        return None
    model = mechanism.model
    body = model.body(payload.body).id
    radius = 0.03 * mechanism.extent_m
    joint = int(model.body_jntadr[body])
    lever = payload.com_m - (model.jnt_pos[joint] if joint >= 0 else 0.0)
    length = float(np.sqrt(12.0 * payload.inertia_kgm2.max() / payload.mass_kg))
    reach = float(np.linalg.norm(lever))
    if length <= 2 * radius or reach <= radius:
        points = payload.com_m[None]
    else:
        half = max(0.5 * length - radius, radius) * lever / reach
        points = np.stack([payload.com_m - half, payload.com_m + half])
    return Solid(body=int(model.body_weldid[body]), points=_in_root(model, body, points), radius=radius, kind="payload")


def _arms(mechanism: Mechanism, shaped: set[int], rod: Solid | None) -> list[Solid]:
    """Return arms from a body's nearest pin: to the sites of moving bodies without geoms, and to a payload that is apart."""
    places, turns = body_frames(mechanism, mechanism.home[None])
    at_home = pins_in_space(mechanism, mechanism.home[None])
    pins = {body: (points[0] - places[0, body]) @ turns[0, body] for body, points in at_home.items()}
    near = 1e-6 * mechanism.extent_m
    ends = [(site.body, site.point, near) for site in visible_sites(mechanism) if site.body not in {0, *shaped}]
    if rod is not None:
        apart = np.linalg.norm(rod.points[:, None] - pins[rod.body], axis=2) if rod.body in pins else np.zeros((1, 1))
        ends.append((rod.body, rod.points[int(np.argmin(apart.min(axis=1)))], 2 * rod.radius))
    found = []
    for body, point, reach in ends:
        distance = np.linalg.norm(pins[body] - point, axis=1) if body in pins else np.zeros(1)
        if distance.min() > reach:
            line = np.stack([pins[body][int(np.argmin(distance))], point])
            found.append(Solid(body=body, points=line, radius=0.006 * mechanism.extent_m, kind="arm"))
    return found


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Place:
    """A named point (3,) [m] in the frame of a body's rigid group."""

    name: str
    body: int
    point: np.ndarray


def visible_sites(mechanism: Mechanism) -> list[Place]:
    """Return the sites that are not hidden, in the frames of their rigid groups."""
    model = mechanism.model
    return [
        Place(
            name=model.site(k).name,
            body=int(model.body_weldid[model.site_bodyid[k]]),
            point=_in_root(model, int(model.site_bodyid[k]), np.array(model.site_pos[k])[None])[0],
        )
        for k in range(model.nsite)
        if model.site_group[k] < 3
    ]


def cut_pins(mechanism: Mechanism) -> list[Place]:
    """Return the points at which active connects and welds close the loops, each on the first of its two bodies."""
    model = mechanism.model
    found = []
    for index in range(model.neq):
        if model.eq_active0[index]:
            for body, point in tied_points(model, index)[:1]:
                root = int(model.body_weldid[body])
                place = _in_root(model, body, np.array(point)[None])[0]
                found.append(Place(name=model.equality(index).name, body=root, point=place))
    return found


def _in_root(model: mujoco.MjModel, body: int, points: np.ndarray) -> np.ndarray:
    """Return points (n, 3) of a body's frame in the frame of its rigid group's root."""
    while body != int(model.body_weldid[body]):
        points = points @ rotation_from_quaternion(model.body_quat[body]).T + model.body_pos[body]
        body = int(model.body_parentid[body])
    return points


def body_frames(mechanism: Mechanism, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions (n, n_body, 3) [m] and rotations (n, n_body, 3, 3) of MuJoCo's bodies at poses (n, n_q)."""
    places, turns = fields_at(mechanism.model, mechanism.qpos_of(poses), "xpos", "xmat")
    return places, turns.reshape(len(poses), -1, 3, 3)


def _shape_of(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, float] | None:
    """Return the points (n, 3) and the radius of a geom in its own frame; None for an unbounded or unknown shape."""
    kind, size = int(model.geom_type[geom]), np.array(model.geom_size[geom])
    if kind == _SPHERE:
        return np.zeros((1, 3)), float(size[0])
    if kind == _CAPSULE:
        return np.array([[0.0, 0.0, -size[1]], [0.0, 0.0, size[1]]]), float(size[0])
    if kind == _ELLIPSOID:
        return directions(80) * size, 0.0
    if kind == _CYLINDER:
        angle = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
        rings = [
            np.stack([size[0] * np.cos(angle), size[0] * np.sin(angle), np.full(24, z)], axis=1) for z in (-size[1], size[1])
        ]
        return np.vstack(rings), 0.0
    if kind == _BOX:
        return _SIGNS * size, 0.0
    if kind == _MESH:
        mesh = int(model.geom_dataid[geom])
        first = int(model.mesh_vertadr[mesh])
        vertices = np.array(model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])], dtype=float)
        return simplified(vertices), 0.0
    return None
