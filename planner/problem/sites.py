"""Tasks in space: points at which sites start or end, and regions in which they stay.

Each limit is on one quantity of a site at p (3,) [m] in the world's frame: n . p for a box's coordinate (n an axis) and for
a wall (n its normal), or the distance from a polyline for a tube.
"""

from dataclasses import dataclass
from typing import get_args

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.planner.keys.kinds import Axis
from linkplan.planner.problem.values import frozen

AXES = get_args(Axis)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SiteLimit:
    """A limit on a site at every instant: a slab low <= n . p <= high [m], or a tube around a polyline.

    Args:
        site: the site's name; `index` is its index in the model.
        what: "x", "y", "z", "wall" or "tube"; `name` adds the site's name, and a number if there are several.
        normal: unit vector n (3,) of a slab; None for a tube.
        low, high: bounds [m]; 0 and the radius for a tube.
        along: the polyline's corners (n, 3) [m]; None for a slab.
        scale: the radius [m] in a tube's row; its own radius by default.
        origin: n . p [m] at which a wall's distance is zero; 0 for a coordinate.
    """

    site: str
    index: int
    what: str
    name: str
    low: float
    high: float
    normal: np.ndarray | None = None
    along: np.ndarray | None = None
    scale: float | None = None
    origin: float = 0.0

    def __post_init__(self) -> None:
        if (self.normal is None) == (self.along is None):
            raise ProblemError(f"limits.site of {self.name} has either a normal or a polyline")
        if not self.low < self.high:
            raise ProblemError(f"limits.site of {self.name} has low < high, got {self.low:g} and {self.high:g}")
        if self.scale is None:
            object.__setattr__(self, "scale", self.high)
        for field in ("normal", "along"):
            value = getattr(self, field)
            if value is not None:
                object.__setattr__(self, field, frozen(value))

    @property
    def is_tube(self) -> bool:
        """Whether it is a tube and not a slab."""
        return self.along is not None

    def value(self, p: np.ndarray) -> np.ndarray:
        """Return the limited quantity (n,) [m] at points (n, 3): a coordinate, or the distance from a wall or polyline."""
        p = np.asarray(p, dtype=float)
        if self.along is None:
            return p @ self.normal - self.origin
        return np.sqrt(
            np.min(np.stack([_squared(p, a, b) for a, b in zip(self.along, self.along[1:], strict=False)]), axis=0)
        )

    @property
    def key(self) -> tuple:
        """The identity of its row in a program, without the bounds: equal keys have equal rows."""
        if self.along is None:
            return self.index, tuple(self.normal.tolist())
        return self.index, tuple(map(tuple, self.along.tolist())), self.scale


def _squared(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the squared distance (n,) of points (n, 3) from the segment a-b."""
    way = b - a
    share = np.clip((p - a) @ way / (way @ way), 0.0, 1.0)
    return np.sum((p - a - share[:, None] * way) ** 2, axis=1)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SitePoint:
    """The place of a site at a motion's start or end: `point` (3,) [m] in the world, NaN where a coordinate is free."""

    site: str
    index: int
    point: np.ndarray

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", frozen(self.point))

    def off_m(self, p: np.ndarray) -> float:
        """Return the distance [m] of a place p (3,) from the point, in the prescribed coordinates."""
        return float(np.sqrt(np.nansum((np.asarray(p) - self.point) ** 2)))
