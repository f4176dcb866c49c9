"""Pictures drawn by Matplotlib, without OpenGL: geoms and skeleton from the same direction, without perspective."""

from dataclasses import dataclass

import mujoco
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import Circle, Polygon

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.solids import geom_solids, outline, thickened
from linkplan.studies.output.body_colours import body_colours
from linkplan.studies.render.framing import FOOT_MARGIN, SIDE_MARGIN, axes_of
from linkplan.studies.render.scenes import Figure, Scene, place_bodies
from linkplan.studies.render.shapes import GHOST, RenderedShape

_DOTS_PER_INCH = 100.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class FlatPainter:
    """Draws scenes along `sight`, with axes `right` and `up` (3,), centre `middle` (2,) [m] and `scale` [px/m]."""

    right: np.ndarray
    up: np.ndarray
    sight: np.ndarray
    middle: np.ndarray
    scale: float
    size: tuple[int, int]
    mechanism: Mechanism  # whose geoms are drawn

    def paint(self, picture: Scene) -> np.ndarray:
        """Return a scene as an image (height, width, 3) of bytes."""
        width, height = self.size
        figure = Canvas(figsize=(width / _DOTS_PER_INCH, height / _DOTS_PER_INCH), dpi=_DOTS_PER_INCH, facecolor="white")
        canvas = FigureCanvasAgg(figure)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        half = np.array(self.size) / (2 * self.scale)
        axes.set_xlim(self.middle[0] - half[0], self.middle[0] + half[0])
        axes.set_ylim(self.middle[1] - half[1], self.middle[1] + half[1])
        axes.set_axis_off()
        for layer, shapes in enumerate((*((*one.ground, *one.shapes) for one in picture.figures), picture.efforts)):
            self._add(axes, shapes, layer)
        for layer, figure in enumerate(picture.figures):
            self._add_geoms(axes, figure, layer)
        canvas.draw()
        return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[:height, :width, :3])

    def _add(self, axes, shapes: tuple[RenderedShape, ...], layer: int) -> None:
        far_first = sorted(shapes, key=lambda shape: -float((shape.start + shape.end) @ self.sight))
        balls = [shape for shape in far_first if np.array_equal(shape.start, shape.end)]
        rods = [shape for shape in far_first if not np.array_equal(shape.start, shape.end)]
        rounds = [Circle(self._flat(ball.start), ball.radius) for ball in balls]
        axes.add_collection(PatchCollection(rounds, facecolors=[ball.rgba for ball in balls], zorder=2 + layer))
        lines = [[self._flat(rod.start), self._flat(rod.end)] for rod in rods]
        widths = [max(1.0, 2 * rod.radius * self.scale) * 72.0 / _DOTS_PER_INCH for rod in rods]
        colours = [rod.rgba for rod in rods]
        axes.add_collection(LineCollection(lines, linewidths=widths, colors=colours, capstyle="round", zorder=2.5 + layer))

    def _add_geoms(self, axes, figure: Figure, layer: int) -> None:
        """Draw the outlines of the geoms from far to near, all behind the skeleton."""
        mechanism = self.mechanism
        data, colours = mujoco.MjData(mechanism.model), body_colours(mechanism)
        place_bodies(mechanism.model, data, figure.qpos)
        found = []
        for solid in geom_solids(mechanism):
            if solid.body == 0 and figure.ghost:
                continue
            points = data.xpos[solid.body] + solid.points @ np.array(data.xmat[solid.body]).reshape(3, 3).T
            colour = GHOST if figure.ghost else (*colours[solid.body][:3], 0.45 * figure.alpha)
            flat = np.stack([points @ self.right, points @ self.up], axis=1)
            found.append((float(np.mean(points @ self.sight)), outline(thickened(flat, solid.radius)), colour))
        for _, edges, colour in sorted(found, key=lambda one: -one[0]):
            if len(edges) > 2:
                axes.add_patch(Polygon(edges, facecolor=colour, edgecolor=(*colour[:3], 2 * colour[3]), zorder=1.5 + layer))

    def _flat(self, point: np.ndarray) -> tuple[float, float]:
        return float(point @ self.right), float(point @ self.up)


def flat_painter(
    points: np.ndarray,
    direction: tuple[float, float],
    size: tuple[int, int],
    head: float,
    mechanism: Mechanism,
) -> FlatPainter:
    """Return the painter that sees all points (n, 3) [m] along an azimuth and elevation [rad].

    Args:
        points: all visible points at all instants.
        direction: azimuth and elevation.
        size: of the pictures, width and height [px].
        head: the free share of the picture's height at the top.
        mechanism: whose geoms are drawn.
    """
    right, up, sight = axes_of(*direction)
    flat = np.stack([points @ right, points @ up], axis=1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    extent = np.maximum(high - low, 1e-6 * max(1e-6, float((high - low).max())))
    scale = float(np.min(np.array([1 - 2 * SIDE_MARGIN, 1 - head - FOOT_MARGIN]) * size / extent))
    middle = 0.5 * (low + high) + np.array([0.0, 0.5 * (head - FOOT_MARGIN) * size[1] / scale])
    return FlatPainter(right=right, up=up, sight=sight, middle=middle, scale=scale, size=size, mechanism=mechanism)
