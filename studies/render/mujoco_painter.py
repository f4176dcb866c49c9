"""Pictures drawn by MuJoCo's own renderer, without a window."""

import contextlib
import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from linkplan.models.errors import LinkplanError, one_line
from linkplan.models.kinematics import data_at
from linkplan.models.poses.solids import visible_geoms
from linkplan.studies.render.framing import Eye
from linkplan.studies.render.gl import context_class
from linkplan.studies.render.scenes import Figure, Scene, bounded_geoms, place_bodies
from linkplan.studies.render.shapes import GHOST, RenderedShape

_MOVING = int(mujoco.mjtCatBit.mjCAT_DYNAMIC)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class MujocoPainter:
    """Draws scenes with one camera. `mujoco_painter` creates it and frees its OpenGL context."""

    model: mujoco.MjModel
    data: mujoco.MjData
    scene: mujoco.MjvScene
    context: mujoco.MjrContext
    camera: mujoco.MjvCamera
    option: mujoco.MjvOption
    size: tuple[int, int]
    ground_is_seen: bool  # the ground has its own geoms

    def paint(self, picture: Scene) -> np.ndarray:
        """Return a scene as an image (height, width, 3) of bytes."""
        width, height = self.size
        main, others = picture.figures[-1], picture.figures[:-1]
        place_bodies(self.model, self.data, main.qpos)
        everything = int(mujoco.mjtCatBit.mjCAT_ALL)
        mujoco.mjv_updateScene(self.model, self.data, self.option, None, self.camera, everything, self.scene)
        add_shapes(self.scene, main.shapes if self.ground_is_seen else (*main.ground, *main.shapes))
        for figure in others:
            place_bodies(self.model, self.data, figure.qpos)
            add_figure(self.scene, self.model, self.data, self.option, figure)
        add_shapes(self.scene, picture.efforts)
        self._add_wall()
        image = np.empty((height, width, 3), dtype=np.uint8)
        whole = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(whole, self.scene, self.context)
        mujoco.mjr_readPixels(image, None, whole, self.context)
        return np.ascontiguousarray(image[::-1])

    def _add_wall(self) -> None:
        """Put a white wall behind everything, so that the background is the same for every model."""
        eye = self.scene.camera[0]
        sight = np.array(eye.forward, dtype=float)
        far = 0.9 * float(eye.frustum_far)  # in front of the clipping plane
        right, up = np.cross(sight, np.array(eye.up, dtype=float)), np.array(eye.up, dtype=float)
        turned = np.stack([right, up, -sight], axis=1)
        wide = 4.0 * far * max(1.0, self.size[0] / self.size[1])
        geom = self.scene.geoms[self.scene.ngeom]
        place = np.array(eye.pos, dtype=float) + far * sight
        box = mujoco.mjtGeom.mjGEOM_BOX
        mujoco.mjv_initGeom(geom, box, np.array([wide, wide, 1e-3 * far]), place, turned.ravel(), np.ones(4, np.float32))
        geom.emission, geom.specular, geom.reflectance = 1.0, 0.0, 0.0
        geom.category = int(mujoco.mjtCatBit.mjCAT_DECOR)  # no shadow
        self.scene.ngeom += 1


@contextlib.contextmanager
def mujoco_painter(
    model: mujoco.MjModel, gl: str, size: tuple[int, int], eye: Eye | int, points: np.ndarray
) -> Iterator[MujocoPainter]:
    """Yield a painter that draws with OpenGL.

    Args:
        model: MuJoCo's.
        gl: the name of the OpenGL.
        size: of the pictures, width and height.
        eye: the camera, or the index of one of the model's cameras.
        points: all visible points (n, 3) [m]; a floor far from them is not drawn.
    """
    model = copy.copy(model)
    model.geom_group[far_planes(model, points)] = mujoco.mjNGROUP - 1  # a group that is not drawn
    width, height = size
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    camera = mujoco.MjvCamera()
    if isinstance(eye, Eye):
        eye.aim(camera)
        # The clipping planes are at a hundredth of the distance and at a hundred times the distance.
        model.stat.extent, model.vis.map.znear, model.vis.map.zfar = eye.distance, 0.01, 100.0
        model.stat.center[:] = eye.target
    else:
        camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, eye
    context = context_class(gl)(width, height)
    try:
        context.make_current()
        try:
            drawn = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        except mujoco.FatalError as error:  # for example a software renderer without memory for its buffers
            raise LinkplanError(f"MuJoCo's renderer cannot draw here: {one_line(error)}") from error
        try:
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, drawn)
            scene = mujoco.MjvScene(model, maxgeom=20_000)
            for flag in (mujoco.mjtRndFlag.mjRND_SKYBOX, mujoco.mjtRndFlag.mjRND_REFLECTION, mujoco.mjtRndFlag.mjRND_SHADOW):
                scene.flags[int(flag)] = False
            yield MujocoPainter(
                model=model,
                data=mujoco.MjData(model),
                scene=scene,
                context=drawn,
                camera=camera,
                option=mujoco.MjvOption(),
                size=size,
                ground_is_seen=bool(
                    (visible_geoms(model) & bounded_geoms(model) & (model.body_weldid[model.geom_bodyid] == 0)).any()
                ),
            )
        finally:
            drawn.free()
    finally:
        context.free()


def far_planes(model: mujoco.MjModel, points: np.ndarray) -> np.ndarray:
    """Return the indices of planes whose distance from the lowest of all points (n, 3) [m] is over 30 % of their extent."""
    far = 0.3 * float(np.ptp(points, axis=0).max())
    data = data_at(model)
    found = []
    for geom in np.flatnonzero(model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)):
        height = (points - np.array(data.geom_xpos[geom])) @ np.array(data.geom_xmat[geom]).reshape(3, 3)[:, 2]
        if not -far < height.min() < far:
            found.append(int(geom))
    return np.array(found, dtype=int)


def add_figure(scene, model: mujoco.MjModel, data: mujoco.MjData, option: mujoco.MjvOption, figure: Figure) -> None:
    """Add a translucent mechanism at the pose of `data`: its moving geoms and its skeleton.

    The geoms of a ghost are 1.5 % smaller, so that they do not flicker where they coincide with the mechanism.
    """
    first = scene.ngeom
    mujoco.mjv_addGeoms(model, data, option, mujoco.MjvPerturb(), _MOVING, scene)
    for k in range(first, scene.ngeom):
        geom = scene.geoms[k]
        if figure.ghost:
            geom.rgba[:], geom.size[:] = GHOST, np.array(geom.size) * 0.985
            geom.matid = -1
        else:
            geom.rgba[3] *= figure.alpha
        geom.transparent = True
    add_shapes(scene, figure.shapes)


def add_shapes(scene, shapes: Sequence[RenderedShape]) -> None:
    """Add shapes to a scene of MuJoCo, up to its capacity."""
    for shape in shapes:
        if scene.ngeom >= scene.maxgeom - 1:
            return
        geom = scene.geoms[scene.ngeom]
        colour = np.array(shape.rgba, dtype=np.float32)
        if float(np.linalg.norm(shape.end - shape.start)) < 1e-9:
            kind = mujoco.mjtGeom.mjGEOM_SPHERE
            mujoco.mjv_initGeom(geom, kind, np.full(3, shape.radius), np.array(shape.start), np.eye(3).ravel(), colour)
        else:
            kind = mujoco.mjtGeom.mjGEOM_CAPSULE
            mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), colour)
            mujoco.mjv_connector(geom, kind, shape.radius, np.array(shape.start), np.array(shape.end))
        geom.category = int(mujoco.mjtCatBit.mjCAT_DECOR)
        geom.transparent = shape.rgba[3] < 1.0
        scene.ngeom += 1
