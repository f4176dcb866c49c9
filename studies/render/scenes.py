"""What is in a picture at an instant: the mechanism, the plan's ghost in the same place, and the efforts."""

import copy
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
# A fixed geom that stands out by more than the first share of what moves is surroundings, held as far as the second.
_BESIDE, _SURROUNDINGS = 0.8, 0.12
# The headlight's least ambient and diffuse parts: MuJoCo's own leave models without lights nearly black.
_AMBIENT, _DIFFUSE = 0.42, 0.48
# Instants at which a motion is looked at to find what the picture must hold.
_LOOKED_AT = 60


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Figure:
    """A mechanism in one pose: MuJoCo's qpos, its skeleton as shapes, the ground's pins apart, and how it is drawn."""

    qpos: np.ndarray
    shapes: tuple[Shape, ...]
    ground: tuple[Shape, ...] = ()
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


def plain_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Return which moving geoms (n_geom,) have no colour of their own: MuJoCo's grey, and no material."""
    grey = np.all(np.isclose(model.geom_rgba, (0.5, 0.5, 0.5, 1.0)), axis=1)
    return grey & (model.geom_matid < 0) & (model.body_weldid[model.geom_bodyid] != 0)


def body_colours(mechanism: Mechanism) -> dict[int, tuple[float, ...]]:
    """Return the rgba of each body: of its first geom that is seen and coloured, else of a series; grey of the ground."""
    model = mechanism.model
    coloured = seen(model) & ~plain_geoms(model) & (model.geom_matid < 0)
    colours: dict[int, tuple[float, ...]] = {0: (0.35, 0.35, 0.35, 1.0)}
    for body in range(1, model.nbody):
        own = np.flatnonzero((model.body_weldid[model.geom_bodyid] == body) & coloured)
        colours[body] = (*map(float, model.geom_rgba[own[0], :3]), 1.0) if len(own) else series_colour(len(colours) - 1)
    return colours


def coloured_model(mechanism: Mechanism) -> mujoco.MjModel:
    """Return a mechanism's model to draw: geoms without a colour have their body's, and no light is too weak to see by."""
    model, colours = copy.copy(mechanism.model), body_colours(mechanism)
    for geom in np.flatnonzero(plain_geoms(model)):
        model.geom_rgba[geom] = colours[int(model.body_weldid[model.geom_bodyid[geom]])]
    light = model.vis.headlight
    light.ambient[:], light.diffuse[:] = np.maximum(light.ambient, _AMBIENT), np.maximum(light.diffuse, _DIFFUSE)
    return model


def rod_radius(mechanism: Mechanism) -> float:
    """Return how thick a skeleton's rods are [m]."""
    return _ROD * mechanism.extent_m


def skeletons(mechanism: Mechanism, poses: np.ndarray) -> list[tuple[Shape, ...]]:
    """Return the skeleton of what moves at each of the poses (n, n_q)."""
    pins, colours = pins_in_space(mechanism, poses), body_colours(mechanism)
    pins.pop(0, None)
    radius = rod_radius(mechanism)
    return [bones({body: points[k] for body, points in pins.items()}, radius, colours) for k in range(len(poses))]


def ground_pins(mechanism: Mechanism) -> tuple[Shape, ...]:
    """Return where a mechanism is pinned to the ground, as balls."""
    pins = {body: points[0] for body, points in pins_in_space(mechanism, mechanism.home[None]).items() if body == 0}
    return bones(pins, rod_radius(mechanism), body_colours(mechanism))


def film_scenes(motion: Motion, instants: np.ndarray, direction: tuple[float, float]) -> list[Scene]:
    """Return the pictures of a film at control instants (n,), seen along an azimuth and elevation [rad]."""
    mechanism = motion.mechanism
    tracked, planned = skeletons(mechanism, motion.pose[instants]), skeletons(mechanism, motion.reference[instants])
    ground = ground_pins(mechanism)
    acting = _all_efforts(motion, instants, direction)
    return [
        Scene(
            figures=(
                Figure(qpos=mechanism.qpos_of(motion.reference[k]), shapes=ghostly(ghost), ghost=True),
                Figure(qpos=mechanism.qpos_of(motion.pose[k]), shapes=own, ground=ground),
            ),
            efforts=efforts,
        )
        for k, own, ghost, efforts in zip(instants, tracked, planned, acting, strict=True)
    ]


def stroboscopic_scene(motion: Motion, instants: np.ndarray, direction: tuple[float, float]) -> Scene:
    """Return several instants (n,) of a motion in one picture, the earlier the fainter; efforts are the last one's."""
    mechanism = motion.mechanism
    ground = ground_pins(mechanism)
    alphas = [0.12 + 0.33 * k / max(1, len(instants) - 1) for k in range(len(instants) - 1)] + [1.0]
    figures = tuple(
        Figure(qpos=mechanism.qpos_of(motion.pose[k]), shapes=faded(own, alpha), ground=ground, alpha=alpha)
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


def all_points(motion: Motion, direction: tuple[float, float]) -> np.ndarray:
    """Return points (n, 3) [m] about all that a motion's pictures are to hold, tracked and planned.

    Pins, geoms, tendons, and efforts as large as they get, seen along an azimuth and elevation [rad].
    """
    mechanism, model = motion.mechanism, motion.mechanism.model
    instants = np.unique(np.linspace(0, len(motion.time_s) - 1, _LOOKED_AT).astype(int))
    poses = np.vstack([motion.pose[instants], motion.reference[instants]])
    points = [points.reshape(-1, 3) for points in pins_in_space(mechanism, poses).values()]
    moves = model.body_weldid[model.geom_bodyid] != 0
    shown = seen(model) & has_end(model)
    data, size, towards = mujoco.MjData(model), mechanism.extent_m, -axes_of(*direction)[2]
    right, up, _ = axes_of(*direction)
    about = np.stack([right, -right, up, -up])
    largest = np.abs(motion.shares).max(axis=0, initial=0.0)
    for pose in poses:
        stand(model, data, mechanism.qpos_of(pose))
        points.append(corners(model, data, np.flatnonzero(shown & moves)))
        points.append(_tendon_points(data))
        for actuator, share in zip(mechanism.actuators, largest, strict=True):
            for signed in (share, -share):
                for shape in effort_shapes(model, data, actuator, float(signed), size, towards):
                    points.append(shape.end + shape.radius * about)
    found = np.vstack(points)
    low, high = found.min(axis=0), found.max(axis=0)
    reach = float(np.max(high - low))
    for geom in np.flatnonzero(shown & ~moves):
        box = corners(model, data, np.array([geom]))
        near = np.all((box >= low - _BESIDE * reach) & (box <= high + _BESIDE * reach))
        margin = (_BESIDE if near else _SURROUNDINGS) * reach
        found = np.vstack([found, np.clip(box, low - margin, high + margin)])
    return found


def has_end(model: mujoco.MjModel) -> np.ndarray:
    """Return which geoms (n_geom,) have an end: not planes and height fields."""
    return ~np.isin(model.geom_type, (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD)))


def _tendon_points(data: mujoco.MjData) -> np.ndarray:
    """Return the points (n, 3) [m] along which tendons run."""
    paths = np.array(data.wrap_xpos).reshape(-1, 3)
    each = [paths[first : first + n] for first, n in zip(data.ten_wrapadr, data.ten_wrapnum, strict=True)]
    return np.vstack([np.zeros((0, 3)), *each])
