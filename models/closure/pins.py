"""Pins that two bodies share. Their geoms overlap there by construction, which is no collision.

The anchor of a joint lies on its body and on the parent. The point of a connect or weld lies on both bodies that it ties.
Two bodies share a pin if two of their points coincide at home, which includes siblings on a pivot and three links on a
bolt. Bodies without a joint between them count as one body, as in MuJoCo's own collision filter.
"""

from collections.abc import Mapping
from itertools import combinations

import mujoco
import numpy as np

from linkplan.models.closure.rank import FILE_ROUNDING_SHARE
from linkplan.models.kinematics import data_at, in_body, in_world
from linkplan.models.ties import tied_points
from linkplan.models.tree.coordinates import BALL, HINGE

Point = tuple[int, np.ndarray]  # a body and a position (3,) [m] in its frame


def shared_pins(model: mujoco.MjModel, home: np.ndarray, extent: float) -> Mapping[tuple[int, int], tuple[Point, ...]]:
    """Return the pins that pairs of bodies share. Keys are pairs of `body_weldid`, the smaller first.

    Args:
        model: the compiled model.
        home: the closed home pose (nq,).
        extent: the mechanism's size [m].
    """
    data = data_at(model, home)
    found: list[tuple[int, np.ndarray]] = []
    for joint in range(model.njnt):
        if int(model.jnt_type[joint]) in (HINGE, BALL):
            body = int(model.jnt_bodyid[joint])
            found += [(end, data.xanchor[joint].copy()) for end in (body, int(model.body_parentid[body]))]
    for index in np.flatnonzero(model.eq_active0):
        for body, place in tied_points(model, int(index)):
            found.append((body, in_world(data, body, place)))
    shared: dict[tuple[int, int], list[Point]] = {}
    for (one, here), (other, there) in combinations(found, 2):
        a, b = sorted((int(model.body_weldid[one]), int(model.body_weldid[other])))
        if a != b and np.linalg.norm(here - there) <= FILE_ROUNDING_SHARE * extent:
            shared.setdefault((a, b), []).append((one, in_body(data, one, here)))
    return {pair: tuple(points) for pair, points in shared.items()}
