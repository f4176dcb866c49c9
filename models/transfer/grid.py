"""Adaptive rectilinear grids for multilinear interpolation, with a measured error.

A function is known at every node of a tensor grid. Each interval of each axis is tested at its middle, on all lines of
nodes across it. Where linear interpolation misses there by more than its share of the tolerance, the interval is halved. The
stated error is measured afterwards at points that were not used: at random in every cell.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

# Intervals of each axis at the start: a dead centre between two nodes must show in a test at the middle.
_FIRST_INTERVALS = 8
# Random points in every cell, and most of all, at which the error is measured.
_POINTS_PER_CELL, _MOST_CHECKED = 2, 4000
# A quantity smaller than this [SI] is zero to rounding, like the slopes of a constant ratio.
_ZERO_SIZE = 1e-12

Function = Callable[[np.ndarray], dict[str, np.ndarray]]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Grid:
    """A function over a rectilinear grid: `axes` of nodes, `values` by name (shape of the grid, ...), NaN off the map.

    `scale` is the largest size of each quantity. `errors` are the largest errors of multilinear interpolation at random
    points between the nodes, as shares of the scale. `checked` is the number of those points.
    """

    axes: tuple[np.ndarray, ...]
    values: dict[str, np.ndarray]
    scale: dict[str, float]
    errors: dict[str, float]
    checked: int

    @property
    def points(self) -> np.ndarray:
        """All nodes (n, n_axes), the last axis first to change."""
        return _tensor(self.axes)

    def at(self, name: str, points: np.ndarray) -> np.ndarray:
        """Return a quantity (n, ...) at points (n, n_axes) by multilinear interpolation; NaN beyond the map."""
        return interpolated(self.axes, self.values[name], points)


def interpolated(axes: Sequence[np.ndarray], values: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return values (n, ...) at points (n, n_axes) by multilinear interpolation, NaN outside."""
    total = np.zeros((len(points), *values.shape[len(axes) :]))
    below, share, inside = [], [], np.ones(len(points), dtype=bool)
    for axis, x in zip(axes, points.T, strict=True):
        k = np.clip(np.searchsorted(axis, x, side="right") - 1, 0, len(axis) - 2)
        below.append(k)
        share.append((x - axis[k]) / (axis[k + 1] - axis[k]))
        inside &= (x >= axis[0]) & (x <= axis[-1])
    for corner in itertools.product((0, 1), repeat=len(axes)):
        weight = np.prod([t if up else 1 - t for t, up in zip(share, corner, strict=True)], axis=0)
        value = values[tuple(k + up for k, up in zip(below, corner, strict=True))]
        shaped = weight.reshape(-1, *[1] * (value.ndim - 1))
        total += np.where(shaped == 0, 0.0, shaped * value)
    total[~inside] = np.nan
    return total


def adaptive_grid(
    function: Function, ends: Sequence[tuple[float, float]], tolerance: float, names: Sequence[str], most_nodes: int
) -> Grid:
    """Return a function on a grid that is fine enough for multilinear interpolation, or as fine as its size allows.

    Args:
        function: from points (n, n_axes) to values by name (n, ...); NaN off the map.
        ends: of each axis.
        tolerance: the error allowed, as a share of each quantity's largest size.
        names: of the quantities that must keep it.
        most_nodes: of the whole grid.
    """
    axes = [np.linspace(low, high, _FIRST_INTERVALS + 1) for low, high in ends]
    known = _Known(function)
    while True:
        values = {name: known(axes)[name] for name in names}
        scale = {name: _size(value) for name, value in values.items()}
        misses = [_misses(known, axes, k, values, scale) for k in range(len(axes))]
        coarse = [miss > tolerance / len(axes) for miss in misses]
        if not any(np.any(intervals) for intervals in coarse):
            break
        fits = np.prod([len(axis) + np.count_nonzero(more) for axis, more in zip(axes, coarse, strict=True)]) <= most_nodes
        if not fits:
            coarse = _coarsest(axes, misses, coarse, most_nodes)
        middles = [0.5 * (axis[:-1] + axis[1:])[halved] for axis, halved in zip(axes, coarse, strict=True)]
        axes = [np.sort(np.concatenate(both)) for both in zip(axes, middles, strict=True)]
        if not fits:
            break  # the measured error says by how much the tolerance is missed
    whole = known(axes)
    scale = {name: _size(value) for name, value in whole.items()}
    errors, checked = _measured(function, axes, whole, scale)
    return Grid(axes=tuple(axes), values=whole, scale=scale, errors=errors, checked=checked)


class _Known:
    """A function with a memory of the points at which it is known. Mutable: `found` grows."""

    def __init__(self, function: Function) -> None:
        self.function = function
        self.found: dict[bytes, dict[str, np.ndarray]] = {}

    def __call__(self, axes: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
        """Return the function's values (shape of the grid, ...) on a tensor grid."""
        points = _tensor(axes)
        keys = [point.tobytes() for point in points]
        new = [k for k, key in enumerate(keys) if key not in self.found]
        if new:
            values = self.function(points[new])
            for row, k in enumerate(new):
                self.found[keys[k]] = {name: value[row] for name, value in values.items()}
        shape = tuple(len(axis) for axis in axes)
        first = self.found[keys[0]]
        return {
            name: np.array([self.found[key][name] for key in keys]).reshape(*shape, *np.shape(value))
            for name, value in first.items()
        }


def _tensor(axes: Sequence[np.ndarray]) -> np.ndarray:
    return np.stack([grid.ravel() for grid in np.meshgrid(*axes, indexing="ij")], axis=-1)


def _size(value: np.ndarray) -> float:
    largest = float(np.abs(value[np.isfinite(value)]).max(initial=0.0))
    return largest if largest > _ZERO_SIZE else 1.0


def _misses(known, axes, k: int, values, scale) -> np.ndarray:
    """Return the misses (n,) of linear interpolation in the middle of each interval of axis k, as shares of the scale."""
    axis = axes[k]
    middles = 0.5 * (axis[:-1] + axis[1:])
    between = known([*axes[:k], middles, *axes[k + 1 :]])
    miss = np.zeros(len(middles))
    for name, value in values.items():
        ends = np.moveaxis(value, k, 0)
        off = np.abs(np.moveaxis(between[name], k, 0) - 0.5 * (ends[:-1] + ends[1:])) / scale[name]
        off = off.reshape(len(middles), -1)
        miss = np.maximum(miss, np.where(np.isfinite(off), off, 0.0).max(axis=1, initial=0.0))
    return miss


def _coarsest(axes, misses, coarse, most_nodes: int) -> list[np.ndarray]:
    """Return masks of the coarse intervals of each axis that miss by most, as many as the size of the grid allows."""
    sizes, chosen = [len(axis) for axis in axes], [np.zeros_like(intervals) for intervals in coarse]
    candidates = [(misses[k][i], k, i) for k, intervals in enumerate(coarse) for i in np.flatnonzero(intervals)]
    for _, k, i in sorted(candidates, reverse=True):
        sizes[k] += 1
        if np.prod(sizes) > most_nodes:
            break
        chosen[k][i] = True
    return chosen


def _measured(function, axes, values, scale) -> tuple[dict[str, float], int]:
    """Return the largest interpolation error of each quantity at random points in the cells, and the number of points."""
    cells = list(itertools.product(*[range(len(axis) - 1) for axis in axes]))
    random = np.random.default_rng(0)
    if len(cells) * _POINTS_PER_CELL > _MOST_CHECKED:
        cells = [cells[k] for k in random.choice(len(cells), _MOST_CHECKED // _POINTS_PER_CELL, replace=False)]
    low = np.array([[axis[k] for axis, k in zip(axes, cell, strict=True)] for cell in cells])
    high = np.array([[axis[k + 1] for axis, k in zip(axes, cell, strict=True)] for cell in cells])
    points = np.concatenate([low + random.random(low.shape) * (high - low) for _ in range(_POINTS_PER_CELL)])
    exact = function(points)
    errors, checked = {}, 0
    for name, value in values.items():
        off = np.abs(interpolated(axes, value, points) - exact[name]).reshape(len(points), -1) / scale[name]
        off = off[np.isfinite(off).all(axis=1)]
        checked = max(checked, len(off))
        errors[name] = float(off.max(initial=0.0))
    return errors, checked
