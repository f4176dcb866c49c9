"""Polynomials by their Bernstein coefficients, on one interval and on many (Farouki, CAGD 29, 2012).

A curve stays in the convex hull of its coefficients. This module avoids scipy.interpolate, whose import takes longer than
planning a small problem.
"""

from dataclasses import dataclass
from functools import cache
from math import comb
from typing import Any, Self

import numpy as np


@dataclass(frozen=True, eq=False, slots=True)
class PiecewisePolynomial:
    """A piecewise polynomial on n intervals: Bernstein coefficients (degree + 1, n, k) and increasing breaks (n + 1,).

    At a break the value is the later interval's; outside the breaks the first and last polynomials are extrapolated.
    """

    coefficients: np.ndarray
    breaks: np.ndarray

    @classmethod
    def through(cls, breaks: np.ndarray, position: np.ndarray, speed: np.ndarray) -> Self:
        """Return quintics through positions and speeds (n + 1, k) at the breaks, with zero acceleration there."""
        h = np.diff(breaks)[:, None]
        left = [position[:-1], position[:-1] + h / 5 * speed[:-1], position[:-1] + 2 * h / 5 * speed[:-1]]
        right = [position[1:] - 2 * h / 5 * speed[1:], position[1:] - h / 5 * speed[1:], position[1:]]
        return cls(np.stack([*left, *right]), np.asarray(breaks, dtype=float))

    def __call__(self, at: np.ndarray) -> np.ndarray:
        """Return values (m, k) at m points."""
        at, n = np.asarray(at, dtype=float), len(self.breaks) - 1
        index = np.clip(np.searchsorted(self.breaks, at, side="right") - 1, 0, n - 1)
        tau = (at - self.breaks[index]) / np.diff(self.breaks)[index]
        basis = bernstein_matrix(len(self.coefficients) - 1, tau.ravel())
        values = np.einsum("mp,pmk->mk", basis, self.coefficients[:, index.ravel()])
        return values.reshape(*at.shape, self.coefficients.shape[2])

    def derivative(self, order: int = 1) -> "PiecewisePolynomial":
        """Return the derivative of the given order."""
        if not order:
            return self
        degree = len(self.coefficients) - 1
        if not degree:
            return PiecewisePolynomial(np.zeros_like(self.coefficients), self.breaks)
        slope = degree * np.diff(self.coefficients, axis=0) / np.diff(self.breaks)[:, None]
        return PiecewisePolynomial(slope, self.breaks).derivative(order - 1)


class OnIntervals:
    """The times of a motion whose intervals end at `breaks_s` (n + 1,) [s]."""

    __slots__ = ()
    breaks_s: np.ndarray

    @property
    def duration_s(self) -> float:
        """The duration [s]."""
        return float(self.breaks_s[-1] - self.breaks_s[0])

    def dense_times(self, per_interval: int = 10) -> np.ndarray:
        """Return increasing times: every interval's two ends and `per_interval` - 1 times between them.

        A break appears twice, just before and at it, so that both sides of a jump in effort are included.
        """
        inner = np.linspace(0.0, 1.0, per_interval + 1)
        inner[-1] = 1.0 - 1e-12
        return self.times_at(inner)

    def times_at(self, points: np.ndarray) -> np.ndarray:
        """Return the times (n_intervals * n,) at shares (n,) of every interval."""
        return (self.breaks_s[:-1, None] + np.diff(self.breaks_s)[:, None] * points).ravel()

    def quadrature(self, per_interval: int = 10) -> tuple[np.ndarray, np.ndarray]:
        """Return times and weights (n_intervals * per_interval,) [s] of Gauss-Legendre quadrature on every interval."""
        nodes, weights = np.polynomial.legendre.leggauss(per_interval)
        return self.times_at(0.5 + 0.5 * nodes), (np.diff(self.breaks_s)[:, None] * 0.5 * weights).ravel()


@cache
def _binomials(n: int) -> np.ndarray:
    return np.array([comb(n, k) for k in range(n + 1)], dtype=float)


def bernstein_matrix(degree: int, points: np.ndarray) -> np.ndarray:
    """Return the Bernstein polynomials (n_points, degree + 1) of a degree at points of [0, 1]."""
    t = np.asarray(points, dtype=float)[:, None]
    k = np.arange(degree + 1)
    return _binomials(degree) * t**k * (1 - t) ** (degree - k)


def bernstein_value(coefficients: Any, at: Any) -> Any:
    """Return the value (n,) of a Bernstein polynomial with coefficients (degree + 1, n) at one point, by de Casteljau.

    Coefficients are numbers, or CasADi symbols, for which the value is a row.
    """
    points = coefficients
    for left in range(points.shape[0] - 1, 0, -1):
        points = points[:left, :] + at * (points[1:, :] - points[:left, :])
    return points[0, :]


def bernstein_gram(degree: int) -> np.ndarray:
    """Return int_0^1 B_i B_j (degree + 1, degree + 1), for exact integrals of squared polynomials."""
    k = np.arange(degree + 1)
    i, j = np.meshgrid(k, k, indexing="ij")
    of = _binomials(degree)
    return np.outer(of, of) / ((2 * degree + 1) * _binomials(2 * degree)[i + j])


def bernstein_product(first: Any, second: Any) -> list:
    """Return the m + n + 1 coefficients of the product of two polynomials, given as numbers or CasADi symbols."""
    m, n = first.shape[0] - 1, second.shape[0] - 1
    of_first, of_second, of_both = _binomials(m), _binomials(n), _binomials(m + n)
    return [
        sum(
            of_first[i] * of_second[k - i] / of_both[k] * first[i] * second[k - i]
            for i in range(max(0, k - n), min(m, k) + 1)
        )
        for k in range(m + n + 1)
    ]


def bernstein_integral(degree: int) -> np.ndarray:
    """Return the matrix (degree + 2, degree + 1) from Bernstein coefficients to those of the integral from 0."""
    return np.tril(np.ones((degree + 2, degree + 1)), -1) / (degree + 1)


def bernstein_part(degree: int, begin: float, end: float) -> np.ndarray:
    """Return the matrix from Bernstein coefficients to those on a part of [0, 1], by blossoms."""
    late, early = ([bernstein_matrix(k, np.array([at]))[0] for k in range(degree + 1)] for at in (end, begin))
    return np.array([np.convolve(late[k], early[degree - k]) for k in range(degree + 1)])


def bernstein_elevation(degree: int, higher: int) -> np.ndarray:
    """Return the matrix (higher + 1, degree + 1) that raises the degree of Bernstein coefficients."""
    i, k = np.meshgrid(np.arange(degree + 1), np.arange(higher + 1))
    rest, step = _binomials(higher - degree), k - i
    inside = (step >= 0) & (step < len(rest))
    return np.where(inside, _binomials(degree)[i] * rest[np.where(inside, step, 0)] / _binomials(higher)[k], 0.0)
