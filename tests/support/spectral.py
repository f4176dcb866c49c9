"""Least efforts between rests by a spectral method: polynomial paths, inverse dynamics, Gauss and Newton's least squares."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Legendre, Polynomial
from scipy.optimize import least_squares

# Polynomials of each path, and Gauss points of the integral: begun with the first, sure where two in turn agree.
_SIZES = ((8, 24), (16, 48), (28, 80), (40, 120))
_AGREE = 1e-8
_TOLERANCES = {"xtol": 1e-13, "ftol": 1e-14, "gtol": 1e-13}
Efforts = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False, kw_only=True, slots=True)
class SpectralPath:
    """A path, the integral of its efforts' squares, and its coefficients (n, n_s) beside the straight way."""

    start: np.ndarray
    goal: np.ndarray
    duration: float
    coefficients: np.ndarray
    objective: float

    def at(self, times: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return positions, rates and accelerations (n_times, n_s)."""
        tables = _tables(len(self.coefficients), times, self.duration)
        return _motion(tables, self.coefficients, self.start, self.goal)


def spectral_path(efforts: Efforts, start: np.ndarray, goal: np.ndarray, duration: float) -> SpectralPath | None:
    """Return the path of least effort next to the straight way; None where polynomials do not settle on one.

    Args:
        efforts: (n, n_u) of positions, rates and accelerations (n, n_s); NaN where there is none.
        start: (n_s,) position, at rest.
        goal: likewise.
        duration: [s].
    """
    best, before = np.zeros((1, len(start))), None
    for n, points in _SIZES:
        x, w = np.polynomial.legendre.leggauss(points)
        tables, w = _tables(n, 0.5 * (x + 1) * duration, duration), 0.5 * w * duration
        begin = np.zeros((n, len(start)))
        begin[: len(best)] = best

        def residuals(flat: np.ndarray, n=n, tables=tables, w=w) -> np.ndarray:
            u = efforts(*_motion(tables, flat.reshape(n, -1), start, goal))
            return np.nan_to_num((np.sqrt(w)[:, None] * u).ravel(), nan=1e6)

        if not np.abs(residuals(begin.ravel())).max() < 1e6:
            return None
        found = least_squares(residuals, begin.ravel(), jac="3-point", **_TOLERANCES)
        best, objective = found.x.reshape(n, -1), 2 * found.cost
        if before is not None and abs(objective / before - 1) < _AGREE:
            return SpectralPath(start=start, goal=goal, duration=duration, coefficients=best, objective=objective)
        before = objective
    return None


def _tables(n: int, times: np.ndarray, duration: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return bumps x^2 (1 - x)^2 P_k(2 x - 1), which leave both ends at rest, and the straight way; with two derivatives."""
    rest = Polynomial([0, 0, 1, -2, 1]).convert(kind=Legendre, domain=[0, 1])
    bumps, straight = [rest * Legendre.basis(k, domain=[0, 1]) for k in range(n)], Polynomial([0, 0, 0, 10, -15, 6])
    x = times / duration
    return [
        (np.array([bump.deriv(d)(x) for bump in bumps]).T / duration**d, straight.deriv(d)(x) / duration**d)
        for d in range(3)
    ]


def _motion(tables, coefficients: np.ndarray, start: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, ...]:
    s, v, a = (bumps @ coefficients + np.outer(line, goal - start) for bumps, line in tables)
    return s + start, v, a
