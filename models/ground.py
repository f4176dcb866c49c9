"""Sites that stand on the ground, and closures that are switched off: what differs between the phases of a leg's motion.

A foot on the ground is one more `connect`, between its site and a point of the world. Its geoms touch the ground there, so
the body and the world are excluded from the search for contacts.
"""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from linkplan.models.errors import ModelError, choose
from linkplan.models.kinematics import CONNECT, data_at


def stand(spec: mujoco.MjSpec, places: Mapping[str, Sequence[float]]) -> None:
    """Add a connect for each site by name to its point (3,) [m] of the world to a specification, named as the site.

    A place may also have the ground's normal (3,) after the point; it is z otherwise.

    Raises:
        ModelError: for an unknown site, one of the world, or a closure with its name.
    """
    sites, named = {site.name: site for site in spec.sites if site.name}, [one.name for one in spec.equalities]
    excluded: set[str] = set()
    for name, place in places.items():
        body = sites[choose("site in mechanism.stand", name, sites)].parent
        if body.name == spec.worldbody.name:
            raise ModelError(f"mechanism.stand: site '{name}' belongs to the world, and cannot stand on it")
        if name in named:
            raise ModelError(f"mechanism.stand: the model already has a closure '{name}'")
        ground = spec.worldbody.add_site(name=f"ground of {name}", pos=place[:3])
        if len(place) > 3:
            turn = np.zeros(4)
            mujoco.mju_quatZ2Vec(turn, np.asarray(place[3:], dtype=float) / np.linalg.norm(place[3:]))
            ground.quat = turn
        kind, of = mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtObj.mjOBJ_SITE
        spec.add_equality(name=name, type=kind, objtype=of, name1=name, name2=f"ground of {name}")
        if body.name not in excluded:
            spec.add_exclude(bodyname1=spec.worldbody.name, bodyname2=body.name)
            excluded.add(body.name)


def open_closures(spec: mujoco.MjSpec, names: Sequence[str]) -> list[str]:
    """Delete closures by name from a specification, and return a note on them.

    Raises:
        ModelError: for an unknown name.
    """
    closures = {one.name: one for one in spec.equalities if one.name}
    for name in names:
        spec.delete(closures[choose("closure in mechanism.open", name, closures)])
    return [f"open: {', '.join(names)}"] if names else []


def ground_normal(model: mujoco.MjModel, index: int) -> np.ndarray | None:
    """Return the direction (3,) in which the ground pushes along the rows of an equality constraint; None if it is none.

    It is the ground's if it connects a site of a body and one of the world, whose z axis is the ground's normal.
    """
    sites = int(model.eq_objtype[index]) == int(mujoco.mjtObj.mjOBJ_SITE)
    if int(model.eq_type[index]) != CONNECT or not sites:
        return None
    ends = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
    fixed = [int(model.body_weldid[model.site_bodyid[site]]) == 0 for site in ends]
    if fixed[0] == fixed[1]:
        return None
    up = data_at(model, model.qpos0).site_xmat[ends[fixed.index(True)]].reshape(3, 3)[:, 2]
    return -up if fixed[0] else up


def ground_of(model: mujoco.MjModel, plane: str | None) -> np.ndarray:
    """Return a point and the upward normal (6,) of the ground: z = 0, or the upper side of a fixed geom.

    Raises:
        ModelError: for an unknown geom, one that moves, or one whose upper side is not flat.
    """
    if plane is None:
        return np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    names = {model.geom(k).name: k for k in range(model.ngeom) if model.geom(k).name}
    geom = names[choose("geom in contacts.plane", plane, names)]
    kind = int(model.geom_type[geom])
    flat = {int(mujoco.mjtGeom.mjGEOM_PLANE): 0.0, int(mujoco.mjtGeom.mjGEOM_BOX): float(model.geom_size[geom][2])}
    if model.body_weldid[model.geom_bodyid[geom]] or kind not in flat:
        raise ModelError(f"contacts.plane: geom '{plane}' must be a fixed plane or box")
    data = data_at(model, model.qpos0)
    normal = data.geom_xmat[geom].reshape(3, 3)[:, 2]
    return np.concatenate([data.geom_xpos[geom] + flat[kind] * normal, normal])
