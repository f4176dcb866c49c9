"""Drawings of efforts: an arc about a driven hinge, an arrow along a slide or a force, a tendon in the load's colour.

The angle of an arc, the length of an arrow and the colour show the effort as a share of its limit.
"""

import itertools

import mujoco
import numpy as np

from linkplan.models.actuation.actuators import Actuator
from linkplan.studies.output.effort_marks import effort_marks
from linkplan.studies.render.shapes import RenderedShape, arrow, load_colour

# Sizes are shares of the mechanism's extent. The offset towards the eye keeps arrows in front of the links.
_ARROW_LENGTH, _SHAFT_RADIUS, _EYE_OFFSET = 0.45, 0.012, 0.06
_HEAD_LENGTH, _HEAD_RADIUS, _HEAD_PARTS = 0.085, 0.028, 18
# The head takes at most this share of a short arrow, and is thinner in proportion.
_MAX_HEAD_SHARE = 0.75
# A smaller share of the limit is not drawn, because the arrow would only have a head.
_MIN_DRAWN_SHARE = 0.02


def load_shares(effort: np.ndarray, limit: np.ndarray, peak: np.ndarray) -> np.ndarray:
    """Return each effort (..., n_u) as a share of the limit with its sign or, without a limit, of its peak.

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
) -> tuple[RenderedShape, ...]:
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
    shapes: tuple[RenderedShape, ...] = ()
    for kind, at, axis in effort_marks(model, data, actuator):
        if kind == "line":
            thick = (0.4 + 0.6 * min(abs(share), 1.0)) * _SHAFT_RADIUS * size
            ends = itertools.pairwise(at)
            shapes += tuple(RenderedShape(start=a, end=b, radius=thick, rgba=load_colour(share)) for a, b in ends)
        else:
            shapes += (_arc if kind == "arc" else _straight)(at, axis, share, size, towards)
    return shapes


def _arc(centre, axis: np.ndarray, share: float, size: float, towards: np.ndarray) -> tuple[RenderedShape, ...]:
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


def _straight(start, direction: np.ndarray, share: float, size: float, towards: np.ndarray) -> tuple[RenderedShape, ...]:
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


def _arrow(points: np.ndarray, long: float, share: float, size: float) -> tuple[RenderedShape, ...]:
    base = size * min(_HEAD_RADIUS, max(_SHAFT_RADIUS, _HEAD_RADIUS * _MAX_HEAD_SHARE * long / (_HEAD_LENGTH * size)))
    thin = size * min(_SHAFT_RADIUS, 0.6 * base / size)
    return arrow(points, thin, load_colour(share), _HEAD_PARTS, base)
