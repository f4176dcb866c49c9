"""What a picture is made of beside the model's own geoms: capsules in space, with colours."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkplan.studies.output.drawing import SERIES

# An effort's colour runs from the first at none to the second at its limit; they differ in lightness too.
_IDLE, _AT_LIMIT = np.array([0.62, 0.62, 0.62]), np.array([0.78, 0.02, 0.09])
_TIP = 0.05  # an arrow's tip, as a share of its head's base
GHOST = (0.50, 0.16, 0.78, 0.32)  # rgba of the reference


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Shape:
    """A capsule from `start` to `end` (3,) [m]; one without length is a ball."""

    start: np.ndarray
    end: np.ndarray
    radius: float  # [m]
    rgba: tuple[float, float, float, float]


def bones(pins: dict[int, np.ndarray], radius: float, colours: dict[int, tuple[float, ...]]) -> tuple[Shape, ...]:
    """Return a skeleton at one instant: rods between a body's pins, balls where pins stand on the ground (body 0).

    Args:
        pins: where each body is pinned to others, by body (n_pins, 3) [m].
        radius: of the rods [m].
        colours: rgba by body.
    """
    found = []
    for body, points in pins.items():
        ends = list(itertools.pairwise(points)) + ([(points[-1], points[0])] if len(points) > 2 else [])
        if body == 0:
            ends = [(point, point) for point in points]
        thick = 1.6 * radius if body == 0 else radius
        found += [Shape(start=a, end=b, radius=thick, rgba=tuple(colours[body])) for a, b in ends]
    return tuple(found)


def arrow(
    points: np.ndarray, radius: float, rgba: tuple[float, float, float, float], head: int, base: float
) -> tuple[Shape, ...]:
    """Return an arrow along points (n, 3) [m], its last `head` stretches a head that tapers from the radius `base` [m]."""
    n = len(points) - 1
    thick = np.append(np.full(n - head, radius), np.linspace(base, _TIP * base, head))
    pairs = zip(points[:-1], points[1:], thick, strict=True)
    return tuple(Shape(start=a, end=b, radius=float(r), rgba=rgba) for a, b, r in pairs)


def faded(shapes: Sequence[Shape], alpha: float) -> tuple[Shape, ...]:
    """Return shapes as translucent as `alpha` says, from 0, not to be seen, to 1, as they are."""
    return tuple(replace(shape, rgba=(*shape.rgba[:3], alpha * shape.rgba[3])) for shape in shapes)


def ghostly(shapes: Sequence[Shape]) -> tuple[Shape, ...]:
    """Return shapes in the ghost's colour."""
    return tuple(replace(shape, rgba=GHOST) for shape in shapes)


def load_colour(share: float) -> tuple[float, float, float, float]:
    """Return the rgba of an effort that is `share` of its limit, of either sign: grey at none, red from the limit on."""
    part = min(abs(share), 1.0)
    red, green, blue = (1 - part) * _IDLE + part * _AT_LIMIT
    return float(red), float(green), float(blue), 1.0


def series_colour(k: int) -> tuple[float, float, float, float]:
    """Return the rgba of the k-th body of a mechanism that has no colours of its own."""
    digits = SERIES[k % len(SERIES)].removeprefix("#")
    red, green, blue = (int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4))
    return red, green, blue, 1.0
