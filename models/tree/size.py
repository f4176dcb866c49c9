"""The size of a mechanism: the length that converts radians to metres."""

import mujoco
import numpy as np

from linkplan.models.kinematics import data_at, in_world
from linkplan.models.ties import tied_points


def extent_m(model: mujoco.MjModel) -> float:
    """Return a model's extent [m]: MuJoCo's own, or the size of the moving bodies if the two differ by a factor above 3.

    The size is the largest side of the box around the moving bodies. A floor, or a statistic in the file, can falsify
    MuJoCo's own extent.
    """
    stated = float(model.stat.extent)
    data = data_at(model)
    moving = np.flatnonzero(np.asarray(model.body_weldid) != 0)
    points = [data.xpos[moving], data.xipos[moving], data.xanchor]
    geoms = np.isin(model.geom_bodyid, moving)
    for sign in (1.0, -1.0):
        points.append(data.geom_xpos[geoms] + sign * model.geom_rbound[geoms, None])
    for index in range(model.neq):
        for body, place in tied_points(model, index):
            points.append(in_world(data, body, place)[None])
    box = np.ptp(np.vstack(points), axis=0)
    size = float(box.max()) if len(moving) else 0.0
    return stated if size <= 0 or size / 3.0 <= stated <= size * 3.0 else size
