"""The size of a mechanism: what a radian is compared with where a length is wanted."""

import mujoco
import numpy as np

from linkplan.models.tree.ties import tied_points

# MuJoCo's own extent serves where it is within this factor of what moves; a floor, or the file's own statistic for the
# viewer, can make it something else.
_FACTOR = 3.0


def extent_m(model: mujoco.MjModel) -> float:
    """Return a model's extent [m]: MuJoCo's, unless that is far from the largest side of the box about what moves."""
    stated = float(model.stat.extent)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    moving = np.flatnonzero(np.asarray(model.body_weldid) != 0)
    points = [data.xpos[moving], data.xipos[moving], data.xanchor]
    geoms = np.isin(model.geom_bodyid, moving)
    for sign in (1.0, -1.0):
        points.append(data.geom_xpos[geoms] + sign * model.geom_rbound[geoms, None])
    for index in range(model.neq):
        for body, place in tied_points(model, index):
            points.append((data.xpos[body] + data.xmat[body].reshape(3, 3) @ place)[None])
    box = np.ptp(np.vstack(points), axis=0)
    size = float(box.max()) if len(moving) else 0.0
    if size <= 0 or size / _FACTOR <= stated <= size * _FACTOR:
        return stated
    return size
