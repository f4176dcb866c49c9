"""The camera of a picture: the mechanism's default, azimuth and elevation, or one of the model's cameras."""

from dataclasses import dataclass

import mujoco
import numpy as np

from linkplan.models.errors import ProblemError, nearest
from linkplan.models.mechanism import Mechanism
from linkplan.studies.render.framing import own_direction
from linkplan.studies.render.scenes import place_bodies


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """A direction of sight, azimuth and elevation [rad], and the index of the model's camera; -1 for a free camera."""

    direction: tuple[float, float]
    fixed: int = -1


def camera_from(text: str | None, mechanism: Mechanism) -> Camera:
    """Return the camera for None (the default), a name, or "azimuth/elevation" in degrees.

    Raises:
        ProblemError: for any other text.
    """
    model = mechanism.model
    if text is None:
        return Camera(direction=own_direction(model))
    names = [model.camera(k).name for k in range(model.ncam)]
    if text in names:
        data = mujoco.MjData(model)
        place_bodies(model, data, mechanism.qpos_of(mechanism.home))
        sight = -np.array(data.cam_xmat[names.index(text)]).reshape(3, 3)[:, 2]
        direction = float(np.arctan2(sight[1], sight[0])), float(np.arcsin(np.clip(sight[2], -1.0, 1.0)))
        return Camera(direction=direction, fixed=names.index(text))
    parts = text.split("/")
    try:
        azimuth, elevation = (float(part) for part in parts)
    except ValueError:
        known = [name for name in names if name]
        has = f"its cameras are {', '.join(known)}" if known else "it has no named camera"
        raise ProblemError(
            f"unknown camera '{text}'{nearest(text, known)} of '{mechanism.name}': {has}; or AZIMUTH/ELEVATION in degrees,"
            " as 90/-15"
        ) from None
    if not (np.isfinite(azimuth) and abs(elevation) <= 90):
        raise ProblemError(f"a camera's elevation must be from -90 to 90 degrees, its azimuth any number, got '{text}'")
    return Camera(direction=(float(np.radians(azimuth)), float(np.radians(elevation))))
