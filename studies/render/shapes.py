"""The shapes of a picture besides the model's geoms: coloured capsules in space."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

# The colours of zero effort and of an effort at its limit; they also differ in lightness.
_IDLE, _AT_LIMIT = np.array([0.62, 0.62, 0.62]), np.array([0.78, 0.02, 0.09])
GHOST = (0.50, 0.16, 0.78, 0.32)  # rgba of the reference


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class RenderedShape:
    """A capsule from `start` to `end` (3,) [m]; with zero length it is a ball."""

    start: np.ndarray
    end: np.ndarray
    radius: float  # [m]
    rgba: tuple[float, ...]


def bones(pins: dict[int, np.ndarray], radius: float, colours: dict[int, tuple[float, ...]]) -> tuple[RenderedShape, ...]:
    """Return a skeleton at one instant: rods between a body's pins, and balls at the pins on the ground (body 0).

    Args:
        pins: the positions (n_pins, 3) [m] of each body's pins, by body.
        radius: of the rods [m].
        colours: rgba by body.
    """
    found = []
    for body, points in pins.items():
        ends = list(itertools.pairwise(points)) + ([(points[-1], points[0])] if len(points) > 2 else [])
        if body == 0:
            ends = [(point, point) for point in points]
        thick = 1.6 * radius if body == 0 else radius
        found += [RenderedShape(start=a, end=b, radius=thick, rgba=tuple(colours[body])) for a, b in ends]
    return tuple(found)


def arrow(points: np.ndarray, radius: float, rgba: tuple[float, ...], head: int, base: float) -> tuple[RenderedShape, ...]:
    """Return an arrow along points (n, 3) [m]; its last `head` segments taper from the radius `base` [m]."""
    n = len(points) - 1
    thick = np.append(np.full(n - head, radius), np.linspace(base, 0.05 * base, head))
    pairs = zip(points[:-1], points[1:], thick, strict=True)
    return tuple(RenderedShape(start=a, end=b, radius=float(r), rgba=rgba) for a, b, r in pairs)


def faded(shapes: Sequence[RenderedShape], alpha: float) -> tuple[RenderedShape, ...]:
    """Return shapes with their opacity multiplied by `alpha`, from 0 to 1."""
    return tuple(replace(shape, rgba=(*shape.rgba[:3], alpha * shape.rgba[3])) for shape in shapes)


def ghostly(shapes: Sequence[RenderedShape]) -> tuple[RenderedShape, ...]:
    """Return shapes in the ghost's colour."""
    return tuple(replace(shape, rgba=GHOST) for shape in shapes)


def load_colour(share: float) -> tuple[float, ...]:
    """Return the rgba of an effort as a share of its limit, of either sign: from grey at 0 to red at 1 and above."""
    part = min(abs(share), 1.0)
    red, green, blue = (1 - part) * _IDLE + part * _AT_LIMIT
    return float(red), float(green), float(blue), 1.0
