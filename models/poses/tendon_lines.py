"""The lines along which tendons run at a pose, through sites and along geoms; pulleys divide a tendon into several."""

import itertools

import mujoco
import numpy as np

# MuJoCo's value of `wrap_obj` for a pulley, which has no place.
_PULLEY_OBJECT = -2


def tendon_lines(data: mujoco.MjData, tendon: int) -> list[np.ndarray]:
    """Return the points (n, 3) [m] of a spatial tendon's branches, after `mj_tendon`."""
    first, n = int(data.ten_wrapadr[tendon]), int(data.ten_wrapnum[tendon])
    points = np.array(data.wrap_xpos).reshape(-1, 3)[first : first + n]
    pulleys = np.flatnonzero(np.array(data.wrap_obj).ravel()[first : first + n] == _PULLEY_OBJECT)
    ends = [-1, *pulleys.tolist(), n]
    return [points[a + 1 : b] for a, b in itertools.pairwise(ends) if b - a > 2]
