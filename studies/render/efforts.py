"""Efforts as arrows: an arc about a driven hinge, a straight arrow along a slide or a force, a tendon in the load's colour.

The angle of an arc, the length of an arrow and the colour show the effort as a share of its limit.
"""

import itertools

import mujoco
import numpy as np

from linkplan.models.actuation.actuators import Actuator
from linkplan.models.actuation.transmission import TRN_CRANK, TRN_IN_PARENT, TRN_JOINT, TRN_SITE, TRN_TENDON, gear_of
from linkplan.models.poses.tendon_lines import tendon_lines
from linkplan.models.tree.coordinates import HINGE, SLIDE
from linkplan.models.tree.tendons import is_fixed
from linkplan.studies.render.shapes import Shape, arrow, load_colour

# Sizes are shares of the mechanism's extent. The offset towards the eye keeps arrows in front of the links.
_ARROW_LENGTH, _SHAFT_RADIUS, _EYE_OFFSET = 0.45, 0.012, 0.06
_HEAD_LENGTH, _HEAD_RADIUS, _HEAD_PARTS = 0.085, 0.028, 18
# The head takes at most this share of a short arrow, and is thinner in proportion.
_MAX_HEAD_SHARE = 0.75
# A smaller share of the limit is not drawn: the arrow would only have a head.
_MIN_DRAWN_SHARE = 0.02


def load_shares(effort: np.ndarray, limit: np.ndarray, peak: np.ndarray) -> np.ndarray:
    """Return each effort (..., n_u) as a share of the limit of its sign, or of its peak if it has no limit.

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
    """Return the shapes of an actuator's effort at the current pose.

    Args:
        model: MuJoCo's.
        data: with the current positions of bodies, sites and tendons.
        actuator: with the effort.
        share: the effort as a share of its limit, with its sign.
        size: the mechanism's extent [m].
        towards: the direction (3,) to the eye; arrows are moved towards it, in front of the links.
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
    """Return an arc about an axis (3,) that starts at the top and is right-handed for a positive `share`.

    An effort at its limit has an arc of 270 degrees.
    """
    if abs(share) < _MIN_DRAWN_SHARE:
        return ()
    up = np.array([0.0, 0.0, 1.0]) if abs(axis[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    first = up - (up @ axis) * axis
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    side = 1.0 if axis @ towards >= 0 else -1.0
    middle = np.array(centre) + _EYE_OFFSET * size * side * axis
    radius = 0.16 * size
    whole = float(np.clip(share, -1.0, 1.0)) * np.radians(270.0)
    angles = _stretches(whole * radius, size, np.radians(8.0) * radius) / radius
    points = middle + radius * (np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second)
    return _arrow(points, abs(whole) * radius, share, size)


def _straight(start, direction: np.ndarray, share: float, size: float, towards: np.ndarray) -> tuple[Shape, ...]:
    """Return an arrow from a point with a length in proportion to `share`."""
    if abs(share) < _MIN_DRAWN_SHARE:
        return ()
    long = float(np.clip(share, -1.0, 1.0)) * _ARROW_LENGTH * size
    along = _stretches(long, size, _ARROW_LENGTH * size)
    return _arrow(np.array(start) + _EYE_OFFSET * size * towards + along[:, None] * direction, abs(long), share, size)


def _stretches(long: float, size: float, step: float) -> np.ndarray:
    """Return the points along an arrow of signed length `long` [m]: its shaft in steps of `step` [m], its head in parts."""
    head = np.sign(long) * min(_HEAD_LENGTH * size, _MAX_HEAD_SHARE * abs(long))
    shaft = np.linspace(0.0, long - head, 1 + max(1, int(np.ceil(abs(long - head) / step))))
    return np.append(shaft, np.linspace(long - head, long, _HEAD_PARTS + 1)[1:])


def _arrow(points: np.ndarray, long: float, share: float, size: float) -> tuple[Shape, ...]:
    base = size * min(_HEAD_RADIUS, max(_SHAFT_RADIUS, _HEAD_RADIUS * _MAX_HEAD_SHARE * long / (_HEAD_LENGTH * size)))
    thin = size * min(_SHAFT_RADIUS, 0.6 * base / size)
    return arrow(points, thin, load_colour(share), _HEAD_PARTS, base)


def _along_tendon(data: mujoco.MjData, tendon: int, share: float, size: float) -> tuple[Shape, ...]:
    pairs = (pair for line in tendon_lines(data, tendon) for pair in itertools.pairwise(line))
    thick = (0.4 + 0.6 * min(abs(share), 1.0)) * _SHAFT_RADIUS * size
    return tuple(Shape(start=a, end=b, radius=thick, rgba=load_colour(share)) for a, b in pairs)
