"""Least efforts of one degree of freedom from rest to rest in a duration, by Pontryagin's conditions."""

import numpy as np
from scipy.integrate import solve_bvp

from tests.support.least_time import Curves

# The conditions' relative residuals; with a limit on the effort they have kinks, which cost nodes.
_TOLERANCE, _NODES = 1e-9, 20000
_TOLERANCE_LIMITED, _NODES_LIMITED = 1e-8, 60000


def least_effort_of(curves: Curves, start: float, goal: float, duration: float, limit: float = np.inf) -> float | None:
    """Return the least integral of u^2 with |u| within a limit; None where the conditions were not solved.

    With H = u^2 + p v + q a the effort is -q B / 2 M, cut at the limit; the motion without a limit is where that begins.
    """
    M, B, h, d, c = curves.inertia, curves.effort, curves.still, curves.square, curves.linear
    dM, dh, dd, dc = (curve.derivative() for curve in (M, h, d, c))

    def within(limit: float):
        def rates(_t: np.ndarray, y: np.ndarray) -> np.ndarray:
            s, v, p, q = y[:4]
            u = np.clip(-q * B(s) / (2 * M(s)), -limit, limit)
            a = (h(s) + d(s) * v**2 + c(s) * v + B(s) * u) / M(s)
            by_place = (dh(s) + dd(s) * v**2 + dc(s) * v - a * dM(s)) / M(s)
            by_speed = (2 * d(s) * v + c(s)) / M(s)
            return np.array([v, a, -q * by_place, -p - q * by_speed, u**2])

        return rates

    def ends(before: np.ndarray, after: np.ndarray) -> np.ndarray:
        return np.array([before[0] - start, before[1], after[0] - goal, after[1], before[4]])

    t = np.linspace(0.0, duration, 201)
    x, span = t / duration, goal - start
    s = start + span * x**3 * (10 - 15 * x + 6 * x**2)
    v = span * 30 * x**2 * (1 - x) ** 2 / duration
    a = span * 60 * x * (1 - x) * (1 - 2 * x) / duration**2
    u = (M(s) * a - h(s) - d(s) * v**2 - c(s) * v) / B(s)
    guess = np.array([s, v, np.zeros_like(s), -2 * M(s) * u / B(s), np.cumsum(u**2) * duration / len(t)])
    with np.errstate(all="ignore"):  # a guess too far away
        found = solve_bvp(within(np.inf), ends, t, guess, tol=_TOLERANCE, max_nodes=_NODES)
        if found.success and np.isfinite(limit):
            kept = {"tol": _TOLERANCE_LIMITED, "max_nodes": _NODES_LIMITED}
            found = solve_bvp(within(limit), ends, found.x, found.y, **kept)
    return float(found.y[4, -1]) if found.success else None
