"""Least efforts of one degree of freedom from rest to rest in a duration: by polynomials, with a limit by Pontryagin."""

import numpy as np
from scipy.integrate import solve_bvp

from tests.support.least_time import Curves
from tests.support.spectral import spectral_path

# The conditions' relative residuals; with a limit on the effort they have kinks, which cost nodes.
_TOLERANCE, _NODES = 1e-8, 20000


def least_effort_of(curves: Curves, start: float, goal: float, duration: float, limit: float = np.inf) -> float | None:
    """Return the least integral of u^2 with |u| within a limit; None where it is not found where the curves are known.

    Within a limit, with H = u^2 + p v + q a, the effort is -q B / 2 M and cut there; that begins with the motion without.
    """
    M, B, h, d, c = curves.inertia, curves.effort, curves.still, curves.square, curves.linear

    def efforts(s: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        return np.where((M.x[0] < s) & (s < M.x[-1]), (M(s) * a - h(s) - d(s) * v**2 - c(s) * v) / B(s), np.nan)

    path = spectral_path(efforts, np.array([start]), np.array([goal]), duration)
    if path is None or not np.isfinite(limit):
        return None if path is None else path.objective
    dM, dh, dd, dc = (curve.derivative() for curve in (M, h, d, c))

    def rates(_t: np.ndarray, y: np.ndarray) -> np.ndarray:
        s, v, p, q = y[:4]
        u = np.clip(-q * B(s) / (2 * M(s)), -limit, limit)
        a = (h(s) + d(s) * v**2 + c(s) * v + B(s) * u) / M(s)
        by_place = (dh(s) + dd(s) * v**2 + dc(s) * v - a * dM(s)) / M(s)
        by_speed = (2 * d(s) * v + c(s)) / M(s)
        return np.array([v, a, -q * by_place, -p - q * by_speed, u**2])

    def ends(before: np.ndarray, after: np.ndarray) -> np.ndarray:
        return np.array([before[0] - start, before[1], after[0] - goal, after[1], before[4]])

    t = np.linspace(0.0, duration, 201)
    s, v, a = (column[:, 0] for column in path.at(t))
    u = efforts(s, v, a)
    q = -2 * M(s) * u / B(s)
    p = -np.gradient(q, t) - q * (2 * d(s) * v + c(s)) / M(s)
    guess = np.array([s, v, p, q, np.cumsum(u**2) * duration / len(t)])
    with np.errstate(all="ignore"):
        found = solve_bvp(rates, ends, t, guess, tol=_TOLERANCE, max_nodes=_NODES)
    inside = M.x[0] < found.y[0].min() and found.y[0].max() < M.x[-1]
    return float(found.y[4, -1]) if found.success and inside else None
