"""The contents of a picture at an instant: the mechanism, the ghost of the plan, and the efforts."""

import copy
from dataclasses import dataclass

import mujoco
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.skeleton import pins_in_space, tendon_lines
from linkplan.models.poses.solids import body_frames, solids, visible_geoms
from linkplan.studies.output.body_colours import PAYLOAD, body_colours, plain_geoms
from linkplan.studies.render.efforts import effort_shapes
from linkplan.studies.render.framing import axes_of, corners
from linkplan.studies.render.motion import TrackedMotion
from linkplan.studies.render.shapes import RenderedShape, bones, faded, ghostly


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Figure:
    """A mechanism in one pose: MuJoCo's qpos, the shapes of its skeleton and of the ground's pins, and its appearance."""

    qpos: np.ndarray
    shapes: tuple[RenderedShape, ...]
    ground: tuple[RenderedShape, ...] = ()
    ghost: bool = False
    alpha: float = 1.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Scene:
    """The content of one picture: figures, the main one last, and efforts as shapes."""

    figures: tuple[Figure, ...]
    efforts: tuple[RenderedShape, ...]


def coloured_model(mechanism: Mechanism) -> mujoco.MjModel:
    """Return the model for drawing: geoms without a colour get their body's colour, and the headlight is brighter.

    With MuJoCo's own headlight, models without lights are nearly black.
    """
    model, colours = copy.copy(mechanism.model), body_colours(mechanism)
    for geom in np.flatnonzero(plain_geoms(model)):
        model.geom_rgba[geom] = colours[int(model.body_weldid[model.geom_bodyid[geom]])]
    light = model.vis.headlight
    light.ambient[:], light.diffuse[:] = np.maximum(light.ambient, 0.42), np.maximum(light.diffuse, 0.48)
    return model


def rod_radius(mechanism: Mechanism) -> float:
    """Return the radius of a skeleton's rods [m]."""
    return 0.009 * mechanism.extent_m


def skeletons(mechanism: Mechanism, poses: np.ndarray) -> list[tuple[RenderedShape, ...]]:
    """Return the skeleton of the moving bodies at each of the poses (n, n_q)."""
    pins, colours = pins_in_space(mechanism, poses), body_colours(mechanism)
    pins.pop(0, None)
    radius, extra = rod_radius(mechanism), beside_geoms(mechanism, poses, colours)
    return [
        (*bones({body: points[k] for body, points in pins.items()}, radius, colours), *extra[k]) for k in range(len(poses))
    ]


def beside_geoms(
    mechanism: Mechanism, poses: np.ndarray, colours: dict[int, tuple[float, ...]]
) -> list[tuple[RenderedShape, ...]]:
    """Return the solids that are not geoms of the model (payload, arms to sites) at each of the poses (n, n_q)."""
    shown = [solid for solid in solids(mechanism) if solid.kind != "geom"]
    places, turns = body_frames(mechanism, poses)
    found = []
    for place, turn in zip(places, turns, strict=True):
        ends = [place[solid.body] + solid.points[[0, -1]] @ turn[solid.body].T for solid in shown]
        looks = [PAYLOAD if solid.kind == "payload" else tuple(colours[solid.body]) for solid in shown]
        rods = zip(ends, shown, looks, strict=True)
        found.append(tuple(RenderedShape(start=a, end=b, radius=solid.radius, rgba=look) for (a, b), solid, look in rods))
    return found


def ground_pins(mechanism: Mechanism) -> tuple[RenderedShape, ...]:
    """Return the pins of a mechanism on the ground as balls."""
    pins = {body: points[0] for body, points in pins_in_space(mechanism, mechanism.home[None]).items() if body == 0}
    return bones(pins, rod_radius(mechanism), body_colours(mechanism))


def film_scenes(motion: TrackedMotion, instants: np.ndarray, direction: tuple[float, float]) -> list[Scene]:
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


def stroboscopic_scene(motion: TrackedMotion, instants: np.ndarray, direction: tuple[float, float]) -> Scene:
    """Return several instants (n,) of a motion in one picture, earlier ones fainter, with the last efforts."""
    mechanism = motion.mechanism
    ground = ground_pins(mechanism)
    alphas = [0.12 + 0.33 * k / max(1, len(instants) - 1) for k in range(len(instants) - 1)] + [1.0]
    figures = tuple(
        Figure(qpos=mechanism.qpos_of(motion.pose[k]), shapes=faded(own, alpha), ground=ground, alpha=alpha)
        for k, own, alpha in zip(instants, skeletons(mechanism, motion.pose[instants]), alphas, strict=True)
    )
    return Scene(figures=figures, efforts=_all_efforts(motion, instants[-1:], direction)[0])


def _all_efforts(
    motion: TrackedMotion, instants: np.ndarray, direction: tuple[float, float]
) -> list[tuple[RenderedShape, ...]]:
    mechanism, data = motion.mechanism, mujoco.MjData(motion.mechanism.model)
    towards = -axes_of(*direction)[2]
    found = []
    for k in instants:
        place_bodies(mechanism.model, data, mechanism.qpos_of(motion.pose[k]))
        found.append(
            tuple(
                shape
                for actuator, share in zip(mechanism.actuators, motion.shares[k], strict=True)
                for shape in effort_shapes(mechanism.model, data, actuator, float(share), mechanism.extent_m, towards)
            )
        )
    return found


def place_bodies(model: mujoco.MjModel, data: mujoco.MjData, qpos: np.ndarray) -> None:
    """Compute the positions of bodies, cameras, lights and tendons at a pose."""
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)
    mujoco.mj_flex(model, data)
    mujoco.mj_tendon(model, data)


def all_points(motion: TrackedMotion, direction: tuple[float, float]) -> np.ndarray:
    """Return points (n, 3) [m] around everything visible in a motion's pictures, tracked and planned.

    These are points of pins, geoms, tendons and the largest efforts, seen along an azimuth and elevation [rad], at 60
    instants. Fixed geoms within 80 % of the moving parts' extent are included; others are cut off at 12 % of the extent.
    """
    mechanism, model = motion.mechanism, motion.mechanism.model
    instants = np.unique(np.linspace(0, len(motion.time_s) - 1, num=60).astype(int))
    poses = np.vstack([motion.pose[instants], motion.reference[instants]])
    points = [points.reshape(-1, 3) for points in pins_in_space(mechanism, poses).values()]
    points += [end[None] for shapes in skeletons(mechanism, poses) for shape in shapes for end in (shape.start, shape.end)]
    moves = model.body_weldid[model.geom_bodyid] != 0
    shown = visible_geoms(model) & bounded_geoms(model)
    data, size, towards = mujoco.MjData(model), mechanism.extent_m, -axes_of(*direction)[2]
    right, up, _ = axes_of(*direction)
    about = np.stack([right, -right, up, -up])
    largest = np.abs(motion.shares).max(axis=0, initial=0.0)
    for pose in poses:
        place_bodies(model, data, mechanism.qpos_of(pose))
        points.append(corners(model, data, np.flatnonzero(shown & moves)))
        points += [line for tendon in range(len(data.ten_length)) for line in tendon_lines(data, tendon)]
        for actuator, share in zip(mechanism.actuators, largest, strict=True):
            for signed in (share, -share):
                for shape in effort_shapes(model, data, actuator, float(signed), size, towards):
                    points.append(shape.end + shape.radius * about)
    found = np.vstack(points)
    low, high = found.min(axis=0), found.max(axis=0)
    reach = float(np.max(high - low))
    for geom in np.flatnonzero(shown & ~moves):
        box = corners(model, data, np.array([geom]))
        near = np.all((box >= low - 0.8 * reach) & (box <= high + 0.8 * reach))
        margin = (0.8 if near else 0.12) * reach
        found = np.vstack([found, np.clip(box, low - margin, high + margin)])
    return found


def bounded_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Return the mask (n_geom,) of bounded geoms, which excludes planes and height fields."""
    return ~np.isin(model.geom_type, (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD)))
