"""Tendon lengths as expressions of the coordinates.

A fixed tendon's length is a linear combination of joint positions. A spatial tendon's length is the length of its path
through sites and around geoms, with each branch divided by its pulley's divisor.

In the plane across a cylinder's axis, or through a sphere's centre, a wrapped segment's ends have the distances d_0 and d_1
from the centre and the angle delta between them, on the side of the rope. The rope leaves the circle of radius r along
tangents of lengths t_i = sqrt(d_i^2 - r^2) = r tan(gamma_i) and covers the arc r (delta - gamma_0 - gamma_1). Where that is
negative the rope is straight; its length's derivative has no jump there. Along a cylinder's axis the rope has a constant
slope. A rope through the inside of a geom, where its side site lies, and one around a sphere with a side site have no
expression here.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.errors import ModelError
from linkplan.models.kinematics import HINGE, data_at
from linkplan.models.symbolic_model import column, number, numeric
from linkplan.models.tree.coordinates import rotation_from_quaternion
from linkplan.models.tree.passive import limits_off

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


JOINT = int(mujoco.mjtWrap.mjWRAP_JOINT)
PULLEY = int(mujoco.mjtWrap.mjWRAP_PULLEY)
SITE = int(mujoco.mjtWrap.mjWRAP_SITE)
# Why a tendon's length has no expression, with the remedy.
LACKING = (
    "passes through the inside of a geom, or around a sphere with a side site: lead it through sites, around the outside of"
    " a cylinder, or make it a fixed tendon with the pulley's radius as the joint's coefficient"
)


def tendon_label(model: mujoco.MjModel, tendon: int) -> str:
    """Return a tendon's name, or a name made from its index."""
    return model.tendon(tendon).name or f"tendon {tendon}"


def path_of(model: mujoco.MjModel, tendon: int) -> range:
    """Return the indices of a tendon's path in the model's list of wrap objects."""
    start = int(model.tendon_adr[tendon])
    return range(start, start + int(model.tendon_num[tendon]))


def is_fixed(model: mujoco.MjModel, tendon: int) -> bool:
    """Return True if a tendon is a linear combination of joint positions."""
    return all(int(model.wrap_type[k]) == JOINT for k in path_of(model, tendon))


def wraps(model: mujoco.MjModel, tendon: int) -> bool:
    """Return True if a tendon's path goes around or through a geom."""
    return bool(_geoms_of(model, tendon))


def lacks_length(model: mujoco.MjModel, tendon: int) -> bool:
    """Return True if a tendon's length has no expression (`models.tree.wrapping`)."""
    return wraps(model, tendon) and None in _sides(model, tendon).values()


def _geoms_of(model: mujoco.MjModel, tendon: int) -> list[int]:
    """Return the geoms of a tendon's path as indices in the model's list of wrap objects."""
    return [k for k in path_of(model, tendon) if int(model.wrap_type[k]) in (CYLINDER, SPHERE)]


def _sides(model: mujoco.MjModel, tendon: int) -> dict[int, str | None]:
    """Return the side of the rope at each geom of a tendon's path, at the model's reference pose."""
    data = data_at(numeric(model))
    return {k: side_of(model, data, k) for k in _geoms_of(model, tendon)}


def tendon_joints(model: mujoco.MjModel, tendon: int) -> dict[int, Any]:
    """Return the coefficients of a fixed tendon's length by coordinate index."""
    found: dict[int, Any] = {}
    for k in path_of(model, tendon):
        dof = int(model.jnt_dofadr[model.wrap_objid[k]])
        found[dof] = found.get(dof, 0.0) + number(model.wrap_prm[k])
    return found


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class TendonRange:
    """The range [low, high] of a tendon's length less its margin; `unit` is "m", or "" if the length sums angles.

    `span` is high - low, the scale of the limit's residual.
    """

    name: str
    index: int
    low: float
    high: float
    span: float
    unit: str


def limited_tendons(model: mujoco.MjModel) -> tuple[TendonRange, ...]:
    """Return a model's tendon limits, except for tendons whose length has no expression."""
    if limits_off(model):
        return ()
    found = []
    for tendon in range(model.ntendon):
        if not model.tendon_limited[tendon] or lacks_length(model, tendon):
            continue
        name, margin = tendon_label(model, tendon), float(model.tendon_margin[tendon])
        low, high = (float(end) for end in model.tendon_range[tendon])
        if low + margin >= high - margin:
            raise ModelError(
                f"tendon {name} is left no length: a margin of {margin:g} at either end leaves nothing of its range {low:g}"
                f" to {high:g}"
            )
        hinges = is_fixed(model, tendon) and any(
            int(model.jnt_type[model.dof_jntid[dof]]) == HINGE for dof in tendon_joints(model, tendon)
        )
        low, high = low + margin, high - margin
        found.append(TendonRange(name=name, index=tendon, low=low, high=high, span=high - low, unit="" if hinges else "m"))
    return tuple(found)


def site_point(model: mujoco.MjModel, frames: Sequence, site: int) -> ca.SX:
    """Return the world position (3,) [m] of a site from the bodies' frames."""
    return frames[int(model.site_bodyid[site])].point(model.site_pos[site])


def tendon_length(model: mujoco.MjModel, frames: Sequence, q: ca.SX, tendon: int) -> ca.SX | None:
    """Return a tendon's length [m], or None if it has no expression.

    Args:
        model: the compiled model.
        frames: the bodies' frames in the world.
        q: the coordinates (n_q,).
        tendon: the tendon's index.
    """
    if lacks_length(model, tendon):
        return None
    if is_fixed(model, tendon):
        return sum((c * q[dof] for dof, c in tendon_joints(model, tendon).items()), ca.SX(0))
    sides = _sides(model, tendon) if wraps(model, tendon) else {}
    length, divisor, before = ca.SX(0), 1.0, None
    for k in path_of(model, tendon):
        if int(model.wrap_type[k]) == PULLEY:
            divisor, before = float(model.wrap_prm[k]), None
            continue
        if k in sides:
            continue
        site = int(model.wrap_objid[k])
        point = site_point(model, frames, site)
        if (side := sides.get(k - 1)) is not None and before is not None:
            length += wrapped_length(model, frames, k - 1, side, (before[1], point)) / divisor
        elif before is not None and int(model.site_bodyid[site]) == int(model.site_bodyid[before[0]]):
            length += number(ca.norm_2(column(model.site_pos[site]) - column(model.site_pos[before[0]]))) / divisor
        elif before is not None:
            # MuJoCo's least length (mjMINVAL) makes the derivative zero, and not 0 / 0, where two sites coincide.
            length += ca.sqrt(ca.fmax(ca.sumsqr(point - before[1]), 1e-15**2)) / divisor
        before = (site, point)
    return length
