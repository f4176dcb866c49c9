"""Pictures drawn by Matplotlib, where there is no OpenGL: the skeleton as seen from the same side, without perspective."""

from dataclasses import dataclass

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from linkplan.studies.render.framing import FOOT, SIDE, axes_of
from linkplan.studies.render.scenes import Scene
from linkplan.studies.render.shapes import Shape

_DPI = 100.0
_THINNEST_PX, _HAIR_PX = 1.0, 0.01


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class FlatPainter:
    """Draws scenes along `sight`: `right` and `up` (3,) are the picture's, `middle` (2,) [m] and `scale` [px/m] frame it."""

    right: np.ndarray
    up: np.ndarray
    sight: np.ndarray
    middle: np.ndarray
    scale: float
    size: tuple[int, int]

    def paint(self, picture: Scene) -> np.ndarray:
        """Return a scene as an image (height, width, 3) of bytes."""
        width, height = self.size
        figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor="white")
        canvas = FigureCanvasAgg(figure)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        half = np.array(self.size) / (2 * self.scale)
        axes.set_xlim(self.middle[0] - half[0], self.middle[0] + half[0])
        axes.set_ylim(self.middle[1] - half[1], self.middle[1] + half[1])
        axes.set_axis_off()
        for layer, shapes in enumerate((*((*one.ground, *one.shapes) for one in picture.figures), picture.efforts)):
            self._add(axes, shapes, layer)
        canvas.draw()
        return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[:height, :width, :3])

    def _add(self, axes, shapes: tuple[Shape, ...], layer: int) -> None:
        far_first = sorted(shapes, key=lambda shape: -float((shape.start + shape.end) @ self.sight))
        # A ball is a line with round ends that is hardly longer than nothing; one of no length would not be drawn.
        hair = _HAIR_PX / self.scale
        ends = [((shape.start, 0.0), (shape.end, hair)) for shape in far_first]
        lines = [[(p @ self.right + aside, p @ self.up) for p, aside in pair] for pair in ends]
        points_per_px = 72.0 / _DPI
        widths = [max(_THINNEST_PX, 2 * shape.radius * self.scale) * points_per_px for shape in far_first]
        colours = [shape.rgba for shape in far_first]
        axes.add_collection(LineCollection(lines, linewidths=widths, colors=colours, capstyle="round", zorder=2 + layer))


def flat_painter(
    points: np.ndarray, direction: tuple[float, float], size: tuple[int, int], head: float = FOOT
) -> FlatPainter:
    """Return the painter that sees all points (n, 3) [m] along an azimuth and elevation [rad].

    Args:
        points: everything that is to be seen, at every instant.
        direction: azimuth and elevation.
        size: of the pictures, width and height [px].
        head: the share of the picture's height that is kept free at the top.
    """
    right, up, sight = axes_of(*direction)
    flat = np.stack([points @ right, points @ up], axis=1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    extent = np.maximum(high - low, 1e-6 * max(1e-6, float((high - low).max())))
    scale = float(np.min(np.array([1 - 2 * SIDE, 1 - head - FOOT]) * size / extent))
    middle = 0.5 * (low + high) + np.array([0.0, 0.5 * (head - FOOT) * size[1] / scale])
    return FlatPainter(right=right, up=up, sight=sight, middle=middle, scale=scale, size=size)
