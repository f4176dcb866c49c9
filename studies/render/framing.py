"""The position of the eye: a direction, and the least distance from which the whole motion is visible."""

from dataclasses import dataclass

import mujoco
import numpy as np

from linkplan.models.kinematics import data_at
from linkplan.models.poses.skeleton import view
from linkplan.models.tree.coordinates import BALL, FREE, SLIDE

# Free margins: at both sides as a share of the picture's width, and at the bottom, for a line of text, of its height.
SIDE_MARGIN, FOOT_MARGIN = 0.05, 0.07
# A planar mechanism is seen slightly from above, to give an impression of depth.
_TILT_DEG = 10.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Eye:
    """A camera with `target` (3,) [m] and `distance` [m], along azimuth and elevation [rad] as defined by MuJoCo."""

    target: np.ndarray
    distance: float
    azimuth: float
    elevation: float

    def aim(self, camera: mujoco.MjvCamera) -> None:
        """Point MuJoCo's free camera."""
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat[:], camera.distance = self.target, self.distance
        camera.azimuth, camera.elevation = np.degrees(self.azimuth), np.degrees(self.elevation)


def axes_of(azimuth: float, elevation: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the picture's right and up and the direction of sight, each (3,), for azimuth and elevation [rad]."""
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    sight = np.array([ce * ca, ce * sa, se])
    return np.array([sa, -ca, 0.0]), np.array([-se * ca, -se * sa, ce]), sight


def own_direction(model: mujoco.MjModel) -> tuple[float, float]:
    """Return azimuth and elevation [rad] of the default view of a mechanism.

    The hinges of a planar mechanism point a little below the eye. A spatial mechanism is seen from the
    side and above. In a planar mechanism all hinge axes are parallel to a thousandth.
    """
    axes = np.array(data_at(model).xaxis[~np.isin(model.jnt_type, (SLIDE, BALL, FREE))]).reshape(-1, 3)
    spread = np.linalg.svd(axes, compute_uv=False) if len(axes) else np.zeros(1)
    if (model.jnt_type == BALL).any() or (len(spread) > 1 and spread[1] > 1e-3 * spread[0]):
        return float(np.radians(125.0)), float(np.radians(-20.0))
    right, up = view(model)
    sight = np.cross(up, right)
    elevation = float(np.arcsin(np.clip(sight[2], -1.0, 1.0)))
    azimuth = float(np.arctan2(-right[0], right[1])) + np.pi if abs(sight[2]) > 1 - 1e-9 else np.arctan2(sight[1], sight[0])
    if abs(sight[2]) < 0.5:
        elevation -= float(np.radians(_TILT_DEG))
    else:  # vertical hinges: the view is tilted to the side
        elevation += float(np.copysign(np.radians(2 * _TILT_DEG), -sight[2]))
    return float(azimuth), elevation


def framed(
    points: np.ndarray, azimuth: float, elevation: float, fovy: float, aspect: float, head: float = FOOT_MARGIN
) -> Eye:
    """Return the nearest eye that sees all points (n, 3) [m] in one picture.

    Args:
        points: all visible points at all instants.
        azimuth: [rad].
        elevation: [rad].
        fovy: the vertical field of view [rad].
        aspect: the picture's width divided by its height.
        head: the free share of the picture's height at the top.
    """
    right, up, sight = axes_of(azimuth, elevation)
    flat = np.stack([points @ right, points @ up, points @ sight], axis=1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    half = np.tan(0.5 * fovy)
    above, below, aside = half * (1 - 2 * head), half * (1 - 2 * FOOT_MARGIN), half * aspect * (1 - 2 * SIDE_MARGIN)
    middle = 0.5 * (low + high)
    middle[1] = (high[1] * below + low[1] * above) / (above + below)
    across, tall, deep = (flat - middle).T
    # A point at depth z behind the target is inside the picture if y <= above (distance + z), and so on.
    needed = np.maximum(np.maximum(tall / above, -tall / below), np.abs(across) / aside) - deep
    distance = float(needed.max())
    smallest = 1e-3 * max(float(np.ptp(points, axis=0).max()), 1e-6)
    return Eye(
        target=middle[0] * right + middle[1] * up + middle[2] * sight,
        distance=max(distance, smallest),
        azimuth=azimuth,
        elevation=elevation,
    )


def corners(model: mujoco.MjModel, data: mujoco.MjData, geoms: np.ndarray) -> np.ndarray:
    """Return the corners (n, 3) [m] of the bounding boxes of geoms at the current pose; `geoms` are MuJoCo's indices."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    boxes = np.array(model.geom_aabb).reshape(-1, 6)[geoms]
    local = boxes[:, None, :3] + signs * boxes[:, None, 3:]
    turned = np.array(data.geom_xmat).reshape(-1, 3, 3)[geoms]
    return (np.einsum("gij,gkj->gki", turned, local) + np.array(data.geom_xpos)[geoms][:, None]).reshape(-1, 3)
