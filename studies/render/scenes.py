"""What is in a picture at an instant: the mechanism, the plan's ghost in the same place, and the efforts."""

from dataclasses import dataclass

import mujoco
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.skeleton import pins_in_space
from linkplan.studies.render.efforts import effort_shapes
from linkplan.studies.render.framing import axes_of, corners
from linkplan.studies.render.motion import Motion
from linkplan.studies.render.shapes import Shape, bones, faded, ghostly, series_colour

# The rods of the skeleton are so thick, as a share of the mechanism's size: to be seen where there are no geoms.
_ROD = 0.009
# Fixed geoms larger than this times what moves are surroundings: the picture need not hold them.
_SURROUNDINGS = 4.0
# Instants at which a motion is looked at to find what the picture must hold.
_LOOKED_AT = 60
# Around a driven joint there is room for an arc of this share of the mechanism's size.
_ARC_ROOM = 0.18


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Figure:
    """A mechanism in one pose: MuJoCo's qpos, its skeleton as shapes, and how it is drawn."""

    qpos: np.ndarray
    shapes: tuple[Shape, ...]
    ghost: bool = False
    alpha: float = 1.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Scene:
    """One picture: figures, the last of them the one that things are about, and efforts as shapes."""

    figures: tuple[Figure, ...]
    efforts: tuple[Shape, ...]


def seen(model: mujoco.MjModel) -> np.ndarray:
    """Return which geoms (n_geom,) a picture shows: not transparent ones, nor of groups that MuJoCo's viewer hides."""
    matte = np.where(model.geom_matid >= 0, 1.0, model.geom_rgba[:, 3])
    return (matte > 0) & (model.geom_group < 3)


def body_colours(mechanism: Mechanism) -> dict[int, tuple[float, ...]]:
    """Return the rgba of each body's rods: of its first geom that is seen, else one of a series; grey of the ground."""
    model = mechanism.model
    colours: dict[int, tuple[float, ...]] = {0: (0.35, 0.35, 0.35, 1.0)}
    for body in range(1, model.nbody):
        own = np.flatnonzero((model.body_weldid[model.geom_bodyid] == body) & seen(model) & (model.geom_matid < 0))
        plain = len(own) and not np.allclose(model.geom_rgba[own[0]], (0.5, 0.5, 0.5, 1.0))
        colours[body] = (*map(float, model.geom_rgba[own[0], :3]), 1.0) if plain else series_colour(len(colours) - 1)
    return colours


def skeletons(mechanism: Mechanism, poses: np.ndarray) -> list[tuple[Shape, ...]]:
    """Return the skeleton of a mechanism at each of the poses (n, n_q)."""
    pins, colours = pins_in_space(mechanism, poses), body_colours(mechanism)
    radius = _ROD * mechanism.extent_m
    return [bones({body: points[k] for body, points in pins.items()}, radius, colours) for k in range(len(poses))]


def film_scenes(motion: Motion, instants: np.ndarray, direction: tuple[float, float]) -> list[Scene]:
    """Return the pictures of a film at control instants (n,), seen along an azimuth and elevation [rad]."""
    mechanism = motion.mechanism
    tracked, planned = skeletons(mechanism, motion.pose[instants]), skeletons(mechanism, motion.reference[instants])
    acting = _all_efforts(motion, instants, direction)
    return [
        Scene(
            figures=(
                Figure(qpos=mechanism.qpos_of(motion.reference[k]), shapes=ghostly(ghost), ghost=True),
                Figure(qpos=mechanism.qpos_of(motion.pose[k]), shapes=own),
            ),
            efforts=efforts,
        )
        for k, own, ghost, efforts in zip(instants, tracked, planned, acting, strict=True)
    ]


def stroboscopic_scene(motion: Motion, instants: np.ndarray, direction: tuple[float, float]) -> Scene:
    """Return several instants (n,) of a motion in one picture, the earlier the fainter; efforts are the last one's."""
    mechanism = motion.mechanism
    alphas = [0.12 + 0.33 * k / max(1, len(instants) - 1) for k in range(len(instants) - 1)] + [1.0]
    figures = tuple(
        Figure(qpos=mechanism.qpos_of(motion.pose[k]), shapes=faded(own, alpha), alpha=alpha)
        for k, own, alpha in zip(instants, skeletons(mechanism, motion.pose[instants]), alphas, strict=True)
    )
    return Scene(figures=figures, efforts=_all_efforts(motion, instants[-1:], direction)[0])


def _all_efforts(motion: Motion, instants: np.ndarray, direction: tuple[float, float]) -> list[tuple[Shape, ...]]:
    mechanism, data = motion.mechanism, mujoco.MjData(motion.mechanism.model)
    towards = -axes_of(*direction)[2]
    found = []
    for k in instants:
        stand(mechanism.model, data, mechanism.qpos_of(motion.pose[k]))
        found.append(
            tuple(
                shape
                for actuator, share in zip(mechanism.actuators, motion.shares[k], strict=True)
                for shape in effort_shapes(mechanism.model, data, actuator, float(share), mechanism.extent_m, towards)
            )
        )
    return found


def stand(model: mujoco.MjModel, data: mujoco.MjData, qpos: np.ndarray) -> None:
    """Put the simulator's bodies, cameras, lights and tendons where a pose has them."""
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)
    mujoco.mj_flex(model, data)
    mujoco.mj_tendon(model, data)


def all_points(motion: Motion) -> np.ndarray:
    """Return points (n, 3) [m] about all that a motion's pictures are to hold: pins, geoms, room for arcs, tracked and planned."""
    mechanism, model = motion.mechanism, motion.mechanism.model
    instants = np.unique(np.linspace(0, len(motion.time_s) - 1, _LOOKED_AT).astype(int))
    poses = np.vstack([motion.pose[instants], motion.reference[instants]])
    points = [points.reshape(-1, 3) for points in pins_in_space(mechanism, poses).values()]
    solid = ~np.isin(model.geom_type, (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD)))
    moves = model.body_weldid[model.geom_bodyid] != 0
    shown = seen(model) & solid
    data = mujoco.MjData(model)
    room = _ARC_ROOM * mechanism.extent_m * np.vstack([np.eye(3), -np.eye(3)])
    for pose in poses:
        stand(model, data, mechanism.qpos_of(pose))
        points.append(corners(model, data, np.flatnonzero(shown & moves)))
        driven = [data.xanchor[model.dof_jntid[a.joint]] for a in mechanism.actuators if a.joint is not None]
        points += [np.array(anchor) + room for anchor in driven]
    found = np.vstack(points)
    low, high = found.min(axis=0), found.max(axis=0)
    reach = float(np.max(high - low))
    for geom in np.flatnonzero(shown & ~moves):
        box = corners(model, data, np.array([geom]))
        if np.all(np.abs(box - 0.5 * (low + high)) <= 0.5 * _SURROUNDINGS * reach):
            found = np.vstack([found, box])
    return found
