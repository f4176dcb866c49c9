"""Curves in space that a site follows: an arc, a polyline with rounded corners, a spline through points.

Every curve has continuous second derivatives by its parameter, so that accelerations along it have no jumps. The third
derivative of a spline jumps at its points. That of a polyline jumps at the ends of its roundings, unless it is asked not to.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from linkplan.models.errors import ModelError

# Two points closer than this share of a path's length are one.
_SAME_POINT_SHARE = 1e-9
# Cells of a piece over which its length is integrated, with ten Gauss points each, and Newton steps to a way on it.
_LENGTH_CELLS, _NEWTON_STEPS = 16, 6
# Sine of the angle between two segments below which they are one line.
_STRAIGHT_SINE = 1e-9


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Arc:
    """centre + radius (cos(x / radius) first + sin(x / radius) second) of the way x [m]; the axes (3,) are orthonormal."""

    centre: np.ndarray
    first: np.ndarray
    second: np.ndarray
    radius: float
    length: float

    def place(self, x: ca.SX) -> ca.SX:
        """Return the place (3,) [m] at the way x [m]."""
        turn = x / self.radius
        return ca.DM(self.centre) + self.radius * (ca.cos(turn) * ca.DM(self.first) + ca.sin(turn) * ca.DM(self.second))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Polynomial:
    """sum over k of coefficients[k] x^k, coefficients (n, 3); x is zero where the piece begins."""

    coefficients: np.ndarray
    length: float

    def place(self, x: ca.SX) -> ca.SX:
        """Return the place (3,) [m] at the parameter x."""
        return _horner(ca.SX(self.coefficients), x)


def _horner(coefficients: ca.SX, x: ca.SX) -> ca.SX:
    """Return sum over k of coefficients[k] x^k (3,), coefficients (n, 3)."""
    value = ca.SX.zeros(3)
    for k in reversed(range(coefficients.shape[0])):
        value = value * x + coefficients[k, :].T
    return value


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve of pieces one after another, over a parameter [m] that begins at 0 and ends at `length`."""

    pieces: tuple[Arc] | tuple[Polynomial, ...]

    @cached_property
    def starts(self) -> np.ndarray:
        """The parameters (n,) at which the pieces begin."""
        return np.concatenate([[0.0], np.cumsum([piece.length for piece in self.pieces])[:-1]])

    @property
    def corners(self) -> np.ndarray:
        """The parameters (n,) at which a higher derivative jumps: the ends of blends, the points of a spline."""
        return self.starts[1:] if isinstance(self.pieces[0], Polynomial) else np.zeros(0)

    @cached_property
    def is_smooth(self) -> bool:
        """Whether the third derivative has no jumps, so that limits on jerk apply."""
        joined = [len(one.coefficients) for one in self.pieces if isinstance(one, Polynomial)]
        return len(self.pieces) == 1 or not {4, 6} & {*joined}  # cubics of a spline, quintics at corners

    @property
    def length(self) -> float:
        """The parameter at the end [m]."""
        return float(sum(piece.length for piece in self.pieces))

    def place(self, x: ca.SX) -> ca.SX:
        """Return the place (3,) [m] at a parameter as an expression; beyond its ends the curve continues."""
        if isinstance(self.pieces[0], Arc):
            return self.pieces[0].place(x)
        # A choice of numbers, not of places: the derivatives of one polynomial are cheap however many pieces there are.
        n = max(len(piece.coefficients) for piece in self.pieces)
        rows = [
            ca.SX([[float(start)], *np.pad(piece.coefficients, ((0, n - len(piece.coefficients)), (0, 0))).reshape(-1, 1)])
            for piece, start in zip(self.pieces, self.starts, strict=True)
        ]
        chosen = rows[0]
        for row, start in zip(rows[1:], self.starts[1:], strict=True):
            chosen = ca.if_else(x < float(start), chosen, row)
        return _horner(ca.reshape(chosen[1:], 3, n).T, x - chosen[0])

    @cached_property
    def function(self) -> ca.Function:
        """The place (3,) and its first two derivatives by the parameter."""
        x = ca.SX.sym("x")
        place = self.place(x)
        slope = ca.jacobian(place, x)
        return ca.Function("curve", [x], [ca.densify(one) for one in (place, slope, ca.jacobian(slope, x))])

    @cached_property
    def ways(self) -> tuple[np.ndarray, np.ndarray]:
        """Parameters (n,) from the beginning to the end, and the lengths of the curve (n,) [m] up to there."""
        ends = zip(self.starts, [piece.length for piece in self.pieces], strict=True)
        x = np.append(
            np.concatenate([start + np.arange(_LENGTH_CELLS) / _LENGTH_CELLS * length for start, length in ends]),
            self.length,
        )
        return x, np.append(0.0, np.cumsum(self._lengths(x[:-1], x[1:])))

    def _lengths(self, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Return the lengths (n,) [m] between two parameters (n,) of one cell each."""
        at, weight = np.polynomial.legendre.leggauss(10)
        half = 0.5 * (last - first)
        x = (first + half)[:, None] + half[:, None] * at
        return half * (np.linalg.norm(self.slopes(x.ravel(), 1), axis=1).reshape(x.shape) @ weight)

    def slopes(self, x: np.ndarray, order: int) -> np.ndarray:
        """Return the first or second derivatives (n, 3) of the place by the parameter, at parameters (n,)."""
        return np.array(self.function.map(len(x))(np.asarray(x)[None])[order]).T

    def at_way(self, way: np.ndarray) -> np.ndarray:
        """Return the parameters (n,) at which the curve has the lengths (n,) [m] from its beginning."""
        knots, until = self.ways
        k = np.clip(np.searchsorted(until, way, side="right") - 1, 0, len(knots) - 2)
        x = np.interp(way, until, knots)
        for _ in range(_NEWTON_STEPS):
            x = x - (until[k] + self._lengths(knots[k], x) - way) / np.linalg.norm(self.slopes(x, 1), axis=1)
        return x

    def along(self, x: np.ndarray, speed: np.ndarray, acceleration: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return x' and x'' (n,) of a speed [m/s] and an acceleration [m/s2] along the curve (n,) at parameters (n,)."""
        slope, bend = self.slopes(x, 1), self.slopes(x, 2)
        size = np.linalg.norm(slope, axis=1)
        rate = speed / size
        return rate, (acceleration - np.einsum("ki,ki->k", slope, bend) / size * rate**2) / size

    def places(self, x: np.ndarray) -> np.ndarray:
        """Return the places (n, 3) [m] at parameters (n,)."""
        return np.array(self.function.map(len(x))(np.asarray(x)[None])[0]).T


def line(points: np.ndarray, blend_m: float, where: str, order: int) -> Curve:
    """Return the polyline through points (n, 3) with corners rounded by polynomials that begin `blend_m` before them.

    Their derivatives up to `order` do not jump.

    Raises:
        ModelError: for a corner that is not rounded, one that turns back, or a segment that is too short for its blends.
    """
    ways = np.diff(points, axis=0)
    lengths = np.linalg.norm(ways, axis=1)
    units = ways / lengths[:, None]
    pieces: list[Polynomial] = []
    begin = 0.0
    for k, (point, unit, length) in enumerate(zip(points, units, lengths, strict=False)):
        last = k + 1 == len(units)
        corner = not last and np.linalg.norm(np.cross(unit, units[k + 1])) > _STRAIGHT_SINE
        if not corner and not last and unit @ units[k + 1] < 0:
            raise ModelError(f"{where} turns back on itself at {_text(points[k + 1])}; end it there")
        if corner and not blend_m:
            raise ModelError(
                f"{where} has a corner at {_text(points[k + 1])}, where a site could only stop;"
                " give the path's blend_m, the distance from a corner at which its rounding begins"
            )
        end = length - (blend_m if corner else 0.0)
        if end - begin < -_SAME_POINT_SHARE * length:
            raise ModelError(
                f"{where} rounds its corners over {blend_m:g} m, and blends overlap on a segment of {length:g} m:"
                " blend_m is at most half of an inner segment, and no longer than an outer one"
            )
        if end > begin:
            pieces.append(Polynomial(coefficients=np.array([point + begin * unit, unit]), length=end - begin))
        if corner:
            pieces.append(_blend(points[k + 1], unit, units[k + 1], blend_m, order))
        begin = blend_m if corner else 0.0
    return Curve(tuple(pieces))


def _text(point: np.ndarray) -> str:
    return f"[{', '.join(f'{x:g}' for x in point)}]"


def _blend(corner: np.ndarray, before: np.ndarray, after: np.ndarray, blend_m: float, order: int) -> Polynomial:
    """Return the polynomial that leaves one line and enters the next with equal derivatives up to an order."""
    length = 2.0 * blend_m  # its parameter is the way along the polyline
    ends, n = (corner - blend_m * before, corner + blend_m * after), order + 1
    rows = np.zeros((2 * n, 2 * n))
    for derivative in range(n):
        for power in range(derivative, 2 * n):
            factor = float(np.prod(np.arange(power - derivative + 1, power + 1)))
            rows[derivative, power] = factor * (power == derivative)
            rows[n + derivative, power] = factor * length ** (power - derivative)
    straight = np.zeros((n - 2, 3))
    values = np.array([ends[0], before, *straight, ends[1], after, *straight])
    return Polynomial(coefficients=np.linalg.solve(rows, values), length=length)


def arc(points: np.ndarray, where: str) -> Curve:
    """Return the circular arc from the first point over the second to the third.

    Raises:
        ModelError: for points on a line.
    """
    a, b, c = points
    u, w = b - a, c - a
    normal = np.cross(u, w)
    size = float(normal @ normal)
    if size <= (_STRAIGHT_SINE * float(np.linalg.norm(u) * np.linalg.norm(w))) ** 2:
        raise ModelError(f"{where} has three points on a line, which no arc joins")
    centre = a + (np.cross(normal, u) * (w @ w) + np.cross(w, normal) * (u @ u)) / (2 * size)
    radius = float(np.linalg.norm(a - centre))
    first = (a - centre) / radius
    second = np.cross(normal / np.sqrt(size), first)
    angle = float(np.arctan2((c - centre) @ second, (c - centre) @ first)) % (2 * np.pi)
    return Curve((Arc(centre=centre, first=first, second=second, radius=radius, length=radius * angle),))


def spline(points: np.ndarray, where: str) -> Curve:
    """Return the natural cubic spline through points (n, 3), over the lengths of the chords.

    Raises:
        ModelError: if it turns back on itself, where its slope is zero.
    """
    import scipy

    chords = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    found = scipy.interpolate.CubicSpline(chords, points, bc_type="natural")
    at = np.array([x for axis in found.derivative().roots(extrapolate=False) for x in [*axis, *chords] if np.isfinite(x)])
    slow = at[np.linalg.norm(found(at, 1), axis=1) <= _STRAIGHT_SINE]
    if len(slow):
        raise ModelError(f"{where} turns back on itself at {_text(found(slow[0]))}; end it there")
    return Curve(
        tuple(Polynomial(coefficients=found.c[::-1, k], length=float(length)) for k, length in enumerate(np.diff(chords)))
    )


SHAPES: dict[str, Callable[[np.ndarray, float, str, int], Curve]] = {
    "polyline": line,
    "spline": lambda points, _blend_m, where, _order: spline(points, where),
    "arc": lambda points, _blend_m, where, _order: arc(points, where),
}


def curve_through(points: Sequence[Sequence[float]], shape: str, blend_m: float, where: str, order: int = 2) -> Curve:
    """Return the curve of a shape through points [m]; derivatives up to `order` do not jump at a polyline's corners.

    Raises:
        ModelError: for points that have no such curve.
    """
    given = np.array(points, dtype=float)
    if len(given) < 2 or (shape == "arc" and len(given) != 3):
        legal = "three points" if shape == "arc" else "two points or more"
        raise ModelError(f"{where} of shape '{shape}' has {legal}, got {len(given)}")
    gaps = np.linalg.norm(np.diff(given, axis=0), axis=1)
    if gaps.min() <= _SAME_POINT_SHARE * gaps.sum():
        raise ModelError(f"{where} has distinct consecutive points, got {_text(given[int(gaps.argmin())])} twice")
    return SHAPES[shape](given, blend_m, where, order)
