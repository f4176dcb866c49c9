"""Lengths of tendon segments that wrap around a sphere or a cylinder, as MuJoCo finds them, as expressions.

In the plane across a cylinder's axis, or through a sphere's centre, the segment's ends have the distances d_0 and d_1 from
the centre and the angle delta between them, on the side of the rope. The rope leaves the circle of radius r along tangents
of lengths t_i = sqrt(d_i^2 - r^2) = r tan(gamma_i) and covers the arc r (delta - gamma_0 - gamma_1). Where that is negative
the rope is straight; its length's derivative has no jump there. Along a cylinder's axis the rope has a constant slope.
A rope through the inside of a geom, where its side site lies, and one around a sphere with a side site have no expression
here.
"""

from collections.abc import Sequence

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.tree.coordinates import rotation_from_quaternion

CYLINDER = int(mujoco.mjtWrap.mjWRAP_CYLINDER)
SPHERE = int(mujoco.mjtWrap.mjWRAP_SPHERE)
# Side of the rope in a cylinder's plane: the shorter way, anticlockwise or clockwise from the first end to the second.
SHORTER, ANTICLOCKWISE, CLOCKWISE = "shorter", "anticlockwise", "clockwise"


def side_of(model: mujoco.MjModel, data: mujoco.MjData, k: int) -> str | None:
    """Return the side of the rope at the geom that is item k of the tendons' paths, or None if it has no expression.

    A side site chooses the way whose middle is nearer to it. The choice is made at the pose of `data`.

    Args:
        model: the compiled model.
        data: at the reference pose, with its kinematics.
        k: the index of the geom in the model's list of wrap objects; sites stand before and behind it.
    """
    geom, site, radius = int(model.wrap_objid[k]), round(float(model.wrap_prm[k])), _radius(model, k)
    if site < 0:
        return SHORTER
    turn, centre = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
    beside = turn.T @ (data.site_xpos[site] - centre)
    if np.linalg.norm(beside) < radius:
        return None
    ends = [turn.T @ (data.site_xpos[int(model.wrap_objid[end])] - centre) for end in (k - 1, k + 1)]
    if int(model.wrap_type[k]) == SPHERE:  # the rope's plane turns with its ends, so the side may change
        return None
    first, second, middle = (np.arctan2(place[1], place[0]) for place in (*ends, beside))
    gammas = [np.arccos(min(1.0, radius / max(np.hypot(*end[:2]), radius))) for end in ends]
    delta = (second - first) % (2 * np.pi)
    ways = ((ANTICLOCKWISE, 1.0, delta), (CLOCKWISE, -1.0, 2 * np.pi - delta))
    start, step = ends[0][:2], ends[1][:2] - ends[0][:2]
    nearest = start + np.clip(-(start @ step) / max(step @ step, 1e-30), 0.0, 1.0) * step
    if np.linalg.norm(nearest) > radius and nearest @ beside[:2] >= 0:  # a straight rope passes the geom on the site's side
        return min(ways, key=lambda way: way[2])[0]
    touching = [way for way in ways if way[2] > sum(gammas)] or list(ways)
    return max(touching, key=lambda way: np.cos(first + way[1] * 0.5 * (way[2] + gammas[0] - gammas[1]) - middle))[0]


def wrapped_length(model: mujoco.MjModel, frames: Sequence, k: int, side: str, ends: Sequence[ca.SX]) -> ca.SX:
    """Return the length [m] of the segment between two points (3,) in the world that wraps around a geom.

    Args:
        model: the compiled model.
        frames: the bodies' frames in the world.
        k: the index of the geom in the model's list of wrap objects.
        side: the rope's side, from `side_of`.
        ends: the two points.
    """
    geom, r = int(model.wrap_objid[k]), _radius(model, k)
    frame = frames[int(model.geom_bodyid[geom])]
    turn = frame.R_world_B @ ca.DM(rotation_from_quaternion(model.geom_quat[geom]))
    centre = frame.point(model.geom_pos[geom])
    first, second = (turn.T @ (end - centre) for end in ends)
    if int(model.wrap_type[k]) == CYLINDER:
        rise, (first, second) = second[2] - first[2], (first[:2], second[:2])
        across = first[0] * second[1] - first[1] * second[0]
    else:
        rise, across = ca.SX(0), _size(ca.cross(first, second))
    along = ca.dot(first, second)
    if side == SHORTER:
        delta = ca.atan2(ca.fabs(across), along)
    else:  # from 0 to a whole turn
        delta = np.pi + ca.atan2(-across if side == ANTICLOCKWISE else across, -along)
    tangents = [_root(ca.sumsqr(end) - r**2) for end in (first, second)]
    arc = delta - sum(ca.atan2(tangent, r) for tangent in tangents)
    touches = ca.logic_and(arc > 0, ca.fmin(ca.sumsqr(first), ca.sumsqr(second)) > r**2)
    flat = ca.if_else(touches, sum(tangents) + r * arc, _size(second - first))
    return _root(flat**2 + rise**2)


def _radius(model: mujoco.MjModel, k: int) -> float:
    return float(model.geom_size[int(model.wrap_objid[k]), 0])


def _size(vector: ca.SX) -> ca.SX:
    return _root(ca.sumsqr(vector))


def _root(value: ca.SX) -> ca.SX:
    """Return a square root whose derivative is finite, also where a rope does not touch the geom."""
    return ca.sqrt(ca.fmax(value, 1e-30))
