"""Pins that two bodies share: where their geoms overlap by construction and not because they meet.

A point of a joint lies on its body and on the parent, a point of a connect or weld on both of the bodies that it ties; two
bodies with points that coincide at home are on one pin, siblings on a pivot and three links on a bolt among them. Bodies
without a joint between them are one, as for MuJoCo's own collision filter.
"""

from collections.abc import Mapping
from itertools import combinations

import mujoco
import numpy as np

from linkplan.models.tree.coordinates import BALL, HINGE
from linkplan.models.tree.ties import tied_points

# Points nearer to one another than this share of the model's extent are one: above a file's rounding, below any pin.
_ONE_POINT = 1e-6

Point = tuple[int, np.ndarray]  # a body and a place (3,) [m] in its frame


def shared_pins(model: mujoco.MjModel, home: np.ndarray, extent: float) -> Mapping[tuple[int, int], tuple[Point, ...]]:
    """Return the pins that pairs of bodies share, bodies by `body_weldid`, the lesser first.

    Args:
        model: whose joints and active equalities make the pins.
        home: the pose (nq,) at which the loops are closed.
        extent: the size [m] that tells rounding from distance.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = home
    mujoco.mj_kinematics(model, data)
    found: list[tuple[int, np.ndarray]] = []
    for joint in range(model.njnt):
        if int(model.jnt_type[joint]) in (HINGE, BALL):
            body = int(model.jnt_bodyid[joint])
            found += [(end, data.xanchor[joint].copy()) for end in (body, int(model.body_parentid[body]))]
    for index in np.flatnonzero(model.eq_active0):
        for body, place in tied_points(model, int(index)):
            found.append((body, data.xpos[body] + data.xmat[body].reshape(3, 3) @ place))
    shared: dict[tuple[int, int], list[Point]] = {}
    for (one, here), (other, there) in combinations(found, 2):
        a, b = sorted((int(model.body_weldid[one]), int(model.body_weldid[other])))
        if a != b and np.linalg.norm(here - there) <= _ONE_POINT * extent:
            local = data.xmat[one].reshape(3, 3).T @ (here - data.xpos[one])
            shared.setdefault((a, b), []).append((one, local))
    return {pair: tuple(points) for pair, points in shared.items()}
