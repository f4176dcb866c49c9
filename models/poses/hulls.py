"""Convex hulls for drawings: a mesh's few corners, an outline in a plane, the faces of a solid."""

import functools

import numpy as np
from scipy.spatial import ConvexHull, QhullError


def simplified(vertices: np.ndarray, most: int = 120) -> np.ndarray:
    """Return at most `most` of the vertices (n, 3): the corners of the hull, or the furthest in evenly spread directions."""
    try:
        corners = vertices[ConvexHull(vertices).vertices]
    except QhullError:  # a flat mesh has no volume
        corners = vertices
    if len(corners) <= most:
        return corners
    return corners[np.unique(np.argmax(corners @ directions(most).T, axis=0))]


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
    """Return points (n, 2), or the points of the circles of a radius around them if it is positive."""
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
