"""What the phase plane says of a four-bar: the least time between two states, and whether there is a motion at all.

With one degree of freedom, energy E = M v^2 / 2 over the crank's angle obeys dE/ds = tau - V'(s), whatever the direction. A
motion is a chain of legs between instants of rest. On a leg the largest energy at every angle is the least of what the push
gives from before (or from where a speed limit was left), what the brake takes until later, and what speed limits admit; the
fastest leg follows it. So the least time is that of the best chain of turning points, and there is no motion where no chain
of legs with positive energies leads from the start to the goal. Nothing here is shared with the package.
"""

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.optimize import minimize

from tests.support.fourbar import FourBar

# Angles on a leg, denser at its ends (as cosines), where energies begin at nought. With speed limits its time is good to
# 1e-7, next to singular poses to 1e-6; without, Gauss points on panels that narrow towards the ends leave rounding.
_FINE, _SETTLING, _COARSE = 6001, 601, 121
_PANELS = (0.0, 1e-3, 1e-2, 0.1, 0.4, 0.7, 1.0)
_GAUSS = tuple(part * 0.5 + shift for part, shift in zip(leggauss(24), (0.5, 0.0), strict=True))
# Turning points among which chains are looked for.
_TURNING = 49
# Turning points next to start and goal [rad], where a motion that begins or ends the other way turns; basins looked into.
_NEAR, _BASINS = np.geomspace(2e-3, 0.3, 6), 3
# A motion that turns back is counted as faster than a straight one only by more than this.
_FASTER = 1e-9
# Crank angles [rad] and speeds [rad/s] at the ends of legs: numbers, or arrays of one shape.
Angles = Speeds = float | np.ndarray


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Phase:
    """A four-bar in its phase plane: torques [N.m] at the crank, speed limits of joints O, A, C [rad/s], angles allowed."""

    fourbar: FourBar
    low: float
    high: float
    speed: tuple[float, float, float] = (np.inf, np.inf, np.inf)
    domain: tuple[float, float]

    def scaled(self, factor: float) -> "Phase":
        """Return the phase plane of torques so many times as wide, about nought."""
        return replace(self, low=factor * self.low, high=factor * self.high)

    def leg(self, a: float, b: float, va: float = 0.0, vb: float = 0.0) -> float:
        """Return the least time [s] straight from a to b, with speeds va, vb at the ends; infinite where there is none."""
        if np.any(np.isfinite(self.speed)):
            return float(self.legs(a, b, va, vb, _FINE))
        if not np.isfinite(self.legs(a, b, va, vb, _SETTLING)):
            return np.inf
        return sum(self._arc(*arc) for arc in self._arcs(a, b, va, vb))

    def _arcs(self, a: Angles, b: Angles, va: Speeds, vb: Speeds) -> list[tuple]:
        """Return for both arcs of legs without a speed limit: the end, the switch, the torque, and the energy V + E."""
        M, V = self.fourbar.energies(np.stack([a, b]))
        push, brake = np.where(b > a, self.high, self.low), np.where(b > a, self.low, self.high)
        first, last = 0.5 * M[0] * np.square(va), 0.5 * M[1] * np.square(vb)
        switch = (last - first + V[1] - V[0] + push * a - brake * b) / (push - brake)
        return [(a, switch, push, first + V[0]), (b, switch, brake, last + V[1])]

    def legs(self, a: Angles, b: Angles, va: Speeds = 0.0, vb: Speeds = 0.0, n: int = _COARSE) -> np.ndarray:
        """Return the least times [s] of legs between angles, arrays that are broadcast, by trapezia over n angles an arc."""
        a, b, va, vb = np.broadcast_arrays(a, b, va, vb)
        time, there = np.full(a.shape, np.inf), (a != b) & (va * (b - a) >= 0) & (vb * (b - a) >= 0)
        ends = [a, b]
        if not np.any(np.isfinite(self.speed)):
            switch = self._arcs(a, b, va, vb)[0][1]
            there &= (np.minimum(a, b) < switch) & (switch < np.maximum(a, b))
            ends = [a, switch, b]
        a, b, va, vb, *ends = (of[there] for of in (a, b, va, vb, *ends))
        share = 0.5 * (1 - np.cos(np.linspace(0, np.pi, n)))
        s = np.concatenate([x[:, None] + (y - x)[:, None] * share for x, y in itertools.pairwise(ends)], axis=1)
        energy, M, is_leg = self._profiles(s, va, vb)
        v = np.sqrt(2 * energy[is_leg] / M[is_leg])
        step, both = np.abs(np.diff(s[is_leg])), v[:, :-1] + v[:, 1:]
        found = np.full(len(is_leg), np.inf)
        found[is_leg] = np.sum(np.divide(2 * step, both, out=np.zeros_like(step), where=step > 0), axis=1)
        time[there] = found
        return time

    def _arc(self, end: float, switch: float, torque: float, total: float) -> float:
        """Return the time [s] between an end and the switch under one torque, `total` the energy V + E at the end."""
        x = np.concatenate([lo + (hi - lo) * _GAUSS[0] for lo, hi in itertools.pairwise(_PANELS)])
        weight = np.concatenate([(hi - lo) * _GAUSS[1] for lo, hi in itertools.pairwise(_PANELS)])
        s = end + (switch - end) * x**2  # takes away the root of the energy at rest
        energy = total + torque * (s - end) - self.fourbar.potential(s)
        if np.any(energy <= 0):
            return np.inf
        return float(np.sum(weight * np.sqrt(self.fourbar.inertia(s) / (2 * energy)) * 2 * x * abs(switch - end)))

    def profile(self, s: np.ndarray, va: float, vb: float) -> tuple[np.ndarray | None, np.ndarray]:
        """Return the largest energies (n,) [J] along a leg's angles, None where there is no such leg, and inertias (n,)."""
        energy, M, is_leg = self._profiles(s, va, vb)
        return energy if is_leg else None, M

    def _profiles(self, s: np.ndarray, va: Speeds, vb: Speeds) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the largest energies and the inertias (..., n) along angles (..., n), and a mask (...,) of the legs."""
        M, V = self.fourbar.energies(s)
        onward = s[..., -1:] > s[..., :1]
        push, brake = np.where(onward, self.high, self.low), np.where(onward, self.low, self.high)
        cap = np.full(s.shape, np.inf)
        if np.any(np.isfinite(self.speed)):
            w = self.fourbar.rates(s)
            for rate, limit in zip((w[0], w[1] - w[0], w[2]), self.speed, strict=True):
                cap = np.minimum(cap, 0.5 * M * (limit / np.maximum(np.abs(rate), 1e-12)) ** 2)
        first, last = 0.5 * M[..., 0] * np.square(va), 0.5 * M[..., -1] * np.square(vb)
        size = np.ptp(V, axis=-1) + (abs(self.high) + abs(self.low)) * np.abs(s[..., -1] - s[..., 0])
        is_leg = (first <= cap[..., 0]) & (last <= cap[..., -1])
        cap[..., 0], cap[..., -1] = first, last
        A, B = push * s - V, brake * s - V
        ahead = A + np.minimum.accumulate(cap - A, axis=-1)
        behind = B + np.minimum.accumulate((cap - B)[..., ::-1], axis=-1)[..., ::-1]
        energy = np.minimum(ahead, behind)
        is_leg &= (np.abs(energy[..., 0] - first) < 1e-12 * size) & (np.abs(energy[..., -1] - last) < 1e-12 * size)
        return energy, M, is_leg & np.all(energy[..., 1:-1] > 0, axis=-1)

    def can_pause(self, a: float, b: float, va: float, vb: float) -> bool:
        """Return whether a leg may come to rest on its way and hold there, so that any longer duration will do too."""
        s = np.linspace(a, b, 2001)
        M, V = self.fourbar.inertia(s), self.fourbar.potential(s)
        slope = np.gradient(V, s)
        push, brake = (self.high, self.low) if b > a else (self.low, self.high)
        entering = 0.5 * M[0] * va**2 + brake * (s - a) - (V - V[0])
        leaving = 0.5 * M[-1] * vb**2 + push * (s - b) - (V - V[-1])
        held = np.all((slope > self.low) & (slope < self.high))
        return bool(held and np.any((entering <= 0) & (leaving <= 0)))

    def chain(
        self, a: float, b: float, va: float = 0.0, vb: float = 0.0, turns: int = 1, n_points: int = _TURNING
    ) -> tuple[float, tuple[float, ...]]:
        """Return the least time [s] from (a, va) to (b, vb) in at most `turns` turns, and the turning points.

        Time is infinite where there is no chain. Found on a grid of turning points, then settled between them.
        """
        near = [x + way * np.sign(v) * _NEAR for x, v, way in ((a, va, 1), (b, vb, -1)) if v]
        points = np.sort(np.concatenate([np.linspace(*self.domain, n_points), *near]))
        points = points[(points >= self.domain[0]) & (points <= self.domain[1])]
        cost, last = self.legs(a, points, va, 0.0), self.legs(points, b, 0.0, vb)
        best, path = self.leg(a, b, va, vb), ()
        routes = [(p,) for p in points]
        between = None
        for turn in range(turns):
            total = cost + last
            for k in _lowest(total):
                if total[k] < best * (1 + 1e-2):
                    time, settled = self._settled(a, b, va, vb, routes[k])
                    if time < best * (1 - _FASTER):
                        best, path = time, settled
            if turn + 1 == turns:
                break
            if between is None:
                between = self.legs(points[:, None], points)
            further = cost[:, None] + between
            before = np.argmin(further, axis=0)
            cost = further[before, np.arange(len(points))]
            routes = [(*routes[i], points[j]) for j, i in enumerate(before)]
        return best, path

    def _settled(self, a: float, b: float, va: float, vb: float, turning: tuple) -> tuple[float, tuple]:
        def time(x: np.ndarray) -> float:
            if np.any((x < self.domain[0]) | (x > self.domain[1])):
                return np.inf
            return sum(self.legs(*legs_of(x), n=_SETTLING))

        def legs_of(x: np.ndarray) -> np.ndarray:
            ends, speeds = np.array([a, *x, b]), np.array([va, *(0.0 for _ in x), vb])
            return np.array([ends[:-1], ends[1:], speeds[:-1], speeds[1:]])

        x = np.array(turning)
        spread = (self.domain[1] - self.domain[0]) / _TURNING
        simplex = np.vstack([x, x + 0.3 * spread * np.eye(len(x))])
        found = minimize(
            time, x, method="Nelder-Mead", options={"initial_simplex": simplex, "xatol": 1e-5, "fatol": 1e-9, "maxiter": 300}
        )
        x = found.x if found.fun <= time(x) else x
        return sum(self.leg(*one) for one in legs_of(x).T), tuple(float(p) for p in x)


def _lowest(values: np.ndarray) -> list[int]:
    """Return the places of the lowest few local minima among finite values (n,), lowest first."""
    padded = np.concatenate([[np.inf], values, [np.inf]])
    places = np.flatnonzero(np.isfinite(values) & (values <= padded[:-2]) & (values <= padded[2:]))
    return [int(k) for k in places[np.argsort(values[places])][:_BASINS]]


def domain_of(fourbar: FourBar, at: float, least: float, ranges: dict[str, tuple[float, float]]) -> tuple[float, float]:
    """Return the crank angles about `at` that a motion may pass: within ranges, the transmission at least `least`."""
    ends = []
    for way in (-1, 1):
        s = at + way * np.linspace(0.0, 10.0, 10001)
        with np.errstate(invalid="ignore"):
            angles = joint_angles(fourbar, s)
            good = np.nan_to_num(fourbar.transmission(s)) >= least
        for name, (low, high) in ranges.items():
            good &= (angles[name] >= low) & (angles[name] <= high)
        stop = np.flatnonzero(~good)
        ends.append(float(s[max(stop[0] - 1, 0)] if len(stop) else s[-1]))
    return ends[0], ends[1]


def joint_angles(fourbar: FourBar, s: np.ndarray) -> dict[str, np.ndarray]:
    """Return the angles (n,) [rad] of joints O, A, C along crank angles that begin where the model is drawn."""
    th = fourbar.angles(s)
    return {"O": th[0], "A": th[1] - th[0], "C": th[2]}


def reaches(phase: Phase, start: float, goal: float, va: float = 0.0) -> bool:
    """Return whether swings could carry the crank to the goal at all, were it able to stop and turn wherever it comes.

    What this denies is surely impossible. The largest energy in either direction at every angle, swept until it settles.
    """
    s = np.linspace(*phase.domain, 1501)
    V, M = phase.fourbar.potential(s), phase.fourbar.inertia(s)
    a, b = (int(np.argmin(np.abs(s - x))) for x in (start, goal))
    most = {way: np.full(len(s), -np.inf) for way in (1, -1)}
    most[1][a] = most[-1][a] = 0.0
    most[1 if va > 0 else -1][a] = 0.5 * M[a] * va**2
    while True:
        before = (most[1].copy(), most[-1].copy())
        for way, push in ((1, phase.high), (-1, phase.low)):
            order = range(1, len(s)) if way > 0 else range(len(s) - 2, -1, -1)
            for k in order:
                arriving = most[way][k - way] + push * (s[k] - s[k - way]) - (V[k] - V[k - way])
                most[way][k] = max(most[way][k], arriving if arriving >= 0 else -np.inf)
        rest = np.maximum(most[1], most[-1]) >= 0
        for way in (1, -1):
            most[way][rest] = np.maximum(most[way][rest], 0.0)
        if most[1][b] >= 0 or most[-1][b] >= 0:
            return True
        if np.array_equal(before[0], most[1]) and np.array_equal(before[1], most[-1]):
            return False
