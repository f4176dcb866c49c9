"""Efforts as arrows: an arc about a driven hinge, a straight arrow along a slide or a force, a tendon in the load's colour.

How far an arc goes round, how long an arrow is and its colour say which share of its limit an effort is.
"""

import itertools

import mujoco
import numpy as np

from linkplan.models.actuation.actuators import Actuator
from linkplan.models.actuation.transmission import TRN_CRANK, TRN_IN_PARENT, TRN_JOINT, TRN_SITE, TRN_TENDON, gear_of
from linkplan.models.tree.coordinates import HINGE, SLIDE
from linkplan.models.tree.tendons import is_fixed
from linkplan.studies.render.shapes import Shape, arrow, load_colour

# An effort at its limit goes so far round [rad]; sizes are shares of the mechanism's.
_FULL_TURN = np.radians(270.0)
_ARC_RADIUS, _ARROW_LENGTH, _THICKNESS, _BESIDE = 0.16, 0.45, 0.012, 0.06
_ARC_STEP = np.radians(8.0)
# An arrow's head: its length and its base's radius as shares of the mechanism's size, made of so many parts; of a short
# arrow it takes this share at the most, and is as much thinner.
_HEAD_LENGTH, _HEAD_BASE, _HEAD_PARTS, _MOSTLY_HEAD = 0.085, 0.028, 18, 0.75
# A smaller share of the limit than this is not drawn: an arrow would be all head.
_LEAST_SHARE = 0.02


def load_shares(effort: np.ndarray, limit: np.ndarray, peak: np.ndarray) -> np.ndarray:
    """Return which share of its limit on its own side each effort (..., n_u) is; of its peak (n_u,) where it has no limit.

    Args:
        effort: [N.m or N].
        limit: (n_u, 2), lower and upper.
        peak: the largest effort of the motion (n_u,).
    """
    side = np.where(np.asarray(effort) < 0, -limit[:, 0], limit[:, 1])
    most = np.where(np.isfinite(side) & (side > 0), side, peak)
    return np.divide(effort, most, out=np.zeros_like(np.asarray(effort, dtype=float)), where=most > 0)


def effort_shapes(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    actuator: Actuator,
    share: float,
    size: float,
    towards: np.ndarray,
) -> tuple[Shape, ...]:
    """Return an actuator's effort as shapes where the mechanism stands.

    Args:
        model: MuJoCo's.
        data: with poses of bodies, sites and tendons worked out.
        actuator: whose effort it is.
        share: of the effort's limit, signed as the effort.
        size: the mechanism's [m].
        towards: the direction (3,) in which the eye is: arcs stand a little that way, not to be hidden by links.
    """
    if not np.isfinite(share):
        return ()
    index = actuator.index
    kind, (on, other) = int(model.actuator_trntype[index]), (int(i) for i in model.actuator_trnid[index])
    gear = gear_of(model, index)
    if kind in (TRN_JOINT, TRN_IN_PARENT):
        return _on_joint(model, data, on, gear, share, size, towards)
    if kind == TRN_TENDON and is_fixed(model, on):
        first = int(model.tendon_adr[on])
        shapes: tuple[Shape, ...] = ()
        for wrap in range(first, first + int(model.tendon_num[on])):
            pull = gear * np.sign(model.wrap_prm[wrap])
            shapes += _on_joint(model, data, int(model.wrap_objid[wrap]), pull, share, size, towards)
        return shapes
    if kind == TRN_TENDON:
        return _along_tendon(data, on, share, size)
    if kind == TRN_CRANK:  # along the slider's axis, which is its site's z
        axis = data.site_xmat[other].reshape(3, 3)[:, 2] * np.sign(gear[0])
        return _straight(data.site_xpos[other], axis, share, size, towards)
    if kind == TRN_SITE:
        turned = np.array(data.site_xmat[on if other < 0 else other]).reshape(3, 3)
        return _wrench(data.site_xpos[on], turned, gear, share, size, towards)
    return ()


def _on_joint(model, data, joint: int, gear: np.ndarray, share: float, size: float, towards) -> tuple[Shape, ...]:
    anchor, axis = np.array(data.xanchor[joint]), np.array(data.xaxis[joint])
    kind = int(model.jnt_type[joint])
    if kind == HINGE:
        return _arc(anchor, axis * np.sign(gear[0]), share, size, towards)
    body = int(model.jnt_bodyid[joint])
    if kind == SLIDE:  # its anchor stays where it is; the body moves
        return _straight(data.xipos[body], axis * np.sign(gear[0]), share, size, towards)
    turned = np.array(data.xmat[body]).reshape(3, 3)
    wrench = gear if gear[3:].any() else np.concatenate([np.zeros(3), gear[:3]])  # a ball's gear is a moment
    return _wrench(anchor, turned, wrench, share, size, towards)


def _wrench(at, turned: np.ndarray, gear: np.ndarray, share: float, size: float, towards) -> tuple[Shape, ...]:
    """Return a site's force and moment: `gear` (6,) in the frame `turned` (3, 3)."""
    force, moment = turned @ gear[:3], turned @ gear[3:]
    shapes = _straight(at, force / np.linalg.norm(force), share, size, towards) if force.any() else ()
    return shapes + (_arc(at, moment / np.linalg.norm(moment), share, size, towards) if moment.any() else ())


def _arc(centre, axis: np.ndarray, share: float, size: float, towards: np.ndarray) -> tuple[Shape, ...]:
    """Return an arc about an axis (3,), right-handed where `share` is above zero, that begins at the top."""
    if abs(share) < _LEAST_SHARE:
        return ()
    up = np.array([0.0, 0.0, 1.0]) if abs(axis[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    first = up - (up @ axis) * axis
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    side = 1.0 if axis @ towards >= 0 else -1.0
    middle = np.array(centre) + _BESIDE * size * side * axis
    radius = _ARC_RADIUS * size
    whole = float(np.clip(share, -1.0, 1.0)) * _FULL_TURN
    angles = _stretches(whole * radius, size, _ARC_STEP * radius) / radius
    points = middle + radius * (np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second)
    return _arrow(points, abs(whole) * radius, share, size)


def _straight(start, direction: np.ndarray, share: float, size: float, towards: np.ndarray) -> tuple[Shape, ...]:
    """Return an arrow from a point, its length the share of the limit."""
    if abs(share) < _LEAST_SHARE:
        return ()
    long = float(np.clip(share, -1.0, 1.0)) * _ARROW_LENGTH * size
    along = _stretches(long, size, _ARROW_LENGTH * size)
    return _arrow(np.array(start) + _BESIDE * size * towards + along[:, None] * direction, abs(long), share, size)


def _stretches(long: float, size: float, step: float) -> np.ndarray:
    """Return where an arrow of length `long` [m], signed, is cut: its shaft by `step` [m], its head into its parts."""
    head = np.sign(long) * min(_HEAD_LENGTH * size, _MOSTLY_HEAD * abs(long))
    shaft = np.linspace(0.0, long - head, 1 + max(1, int(np.ceil(abs(long - head) / step))))
    return np.append(shaft, np.linspace(long - head, long, _HEAD_PARTS + 1)[1:])


def _arrow(points: np.ndarray, long: float, share: float, size: float) -> tuple[Shape, ...]:
    base = size * min(_HEAD_BASE, max(_THICKNESS, _HEAD_BASE * _MOSTLY_HEAD * long / (_HEAD_LENGTH * size)))
    thin = size * min(_THICKNESS, 0.6 * base / size)
    return arrow(points, thin, load_colour(share), _HEAD_PARTS, base)


def _along_tendon(data: mujoco.MjData, tendon: int, share: float, size: float) -> tuple[Shape, ...]:
    first, n = int(data.ten_wrapadr[tendon]), int(data.ten_wrapnum[tendon])
    points = np.array(data.wrap_xpos).reshape(-1, 3)[first : first + n]
    apart = itertools.pairwise(points)
    thick = (0.4 + 0.6 * min(abs(share), 1.0)) * _THICKNESS * size
    return tuple(Shape(start=a, end=b, radius=thick, rgba=load_colour(share)) for a, b in apart)
