"""Contacts between geoms along poses: forces that the reduced dynamics do not know."""

from dataclasses import dataclass

import mujoco
import numpy as np

from models.mechanism import Mechanism


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ContactPair:
    """Two geoms that touch at one or more of the poses looked at: at which (indices), and how deep at the worst [m]."""

    first: str
    second: str
    poses: tuple[int, ...]
    depth_m: float


def contact_pairs(mechanism: Mechanism, poses: np.ndarray) -> tuple[ContactPair, ...]:
    """Return the pairs of geoms in contact at poses (n, n_q), by MuJoCo's own collision detection."""
    model = mechanism.model
    data = mujoco.MjData(model)
    found: dict[tuple[int, int], tuple[list[int], float]] = {}
    for k, pose in enumerate(poses):
        data.qpos[:] = mechanism.qpos_of(pose)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        for contact in data.contact[: data.ncon]:
            pair = tuple(sorted((int(contact.geom1), int(contact.geom2))))
            at, depth = found.setdefault(pair, ([], 0.0))
            if not at or at[-1] != k:
                at.append(k)
            found[pair] = (at, max(depth, -float(contact.dist)))
    return tuple(
        ContactPair(first=_geom(model, a), second=_geom(model, b), poses=tuple(at), depth_m=depth)
        for (a, b), (at, depth) in sorted(found.items())
    )


def _geom(model: mujoco.MjModel, index: int) -> str:
    name = model.geom(index).name
    if name:
        return name
    body = model.body(int(model.geom_bodyid[index])).name or f"body {int(model.geom_bodyid[index])}"
    return f"geom {index} of {body}"
