"""What a leg of the phase plane may do: all that limits on effort, power and pin force allow at a place and a speed.

With one degree of freedom each of these limits is a bound on the effort there: a power P bounds it by P / w, and a pin force
is affine in the effort, so that its rating R bounds it by the roots of |F(s, v, u)|^2 = R^2.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

# What an actuator is held at: its effort's limit (1 upper, -1 lower), its power's, or, from this number on, the force of a
# limited closure, at the larger effort at which it is reached (positive) or the smaller one (negative).
POWER, FORCE = 2, 3
# Efforts, powers and forces beyond their limit by no more than this share keep it.
_KEPT = 1e-6


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PinForces:
    """Forces of closures that are limited, along a part of the way: F = still + square v^2 + linear v + by_effort u.

    `curves` gives (4, n_rows) [N, ...] over the coordinate, divided by the closures' ratings; `rows` are those of each.
    """

    curves: Callable[[Any], np.ndarray]
    rows: tuple[slice, ...]

    def efforts(self, s: Any, v: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the least and largest efforts (..., n_closures) that each closure bears, and whether it bears any.

        Where it bears none, both are the effort at which its force is least.
        """
        values, v = self.curves(s), np.asarray(v, dtype=float)[..., None]
        force = values[..., 0, :] + values[..., 1, :] * v**2 + values[..., 2, :] * v
        least, most, bears = [], [], []
        for rows in self.rows:
            given, by = force[..., rows], values[..., 3, rows]
            a, b, c = (by * by).sum(axis=-1), (by * given).sum(axis=-1), (given * given).sum(axis=-1) - 1.0
            a = np.maximum(a, np.finfo(float).tiny)
            within = b * b - a * c
            root = np.sqrt(np.maximum(within, 0.0))
            least.append((-b - root) / a)
            most.append((-b + root) / a)
            bears.append(within >= 0)
        return np.stack(least, axis=-1), np.stack(most, axis=-1), np.stack(bears, axis=-1)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class LegField:
    """All that effort, power and pin forces allow along a part of the way.

    M a = still + square v^2 + linear v + maps u; `curves` gives (M, still, square, linear, maps...) over the coordinate.
    `effort` (n_u, 2) [N.m or N], `power` (n_u, 2) [W], `way` +1 or -1; `pins` is None where no pin force is limited.
    """

    curves: Callable[[Any], np.ndarray]
    effort: np.ndarray
    power: np.ndarray
    way: float
    pins: PinForces | None = None

    def at(self, s: Any, v: Any, *, towards: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return what actuators are held at (..., n_u), the efforts (..., n_u) and the acceleration at places and speeds.

        The efforts are those that push towards the end, or brake.
        """
        maps = self.curves(s)[..., 4:]
        upper = (maps * self.way > 0) == towards
        held, effort = np.where(upper, 1, -1), np.where(upper, self.effort[:, 1], self.effort[:, 0])
        spent = effort * maps * np.asarray(v)[..., None]
        held = np.where(spent > self.power[:, 1], POWER, np.where(spent < self.power[:, 0], -POWER, held))
        effort, a = self.along(s, v, held)
        if self.pins is None:
            return held, effort, a
        least, most, _ = self.pins.efforts(s, v)
        beyond = effort > most.min(axis=-1, keepdims=True)
        short = ~beyond & (effort < least.max(axis=-1, keepdims=True))
        held = np.where(beyond, FORCE + np.argmin(most, axis=-1)[..., None], held)
        held = np.where(short, -FORCE - np.argmax(least, axis=-1)[..., None], held)
        return held, *self.along(s, v, held)

    def along(self, s: Any, v: Any, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the efforts (..., n_u) of actuators that are held at limits, and the acceleration, at places and speeds."""
        values, v = self.curves(s), np.asarray(v, dtype=float)
        rate, on_power = values[..., 4:] * v[..., None], np.abs(held) == POWER
        upper = np.asarray(held) > 0
        power, limit = (np.where(upper, of[:, 1], of[:, 0]) for of in (self.power, self.effort))
        effort = np.where(on_power, power / np.where(on_power, rate, 1.0), limit)
        if self.pins is not None and np.any(np.abs(held) >= FORCE):
            least, most, _ = self.pins.efforts(s, v)
            for k in range(least.shape[-1]):
                effort = np.where(held == FORCE + k, most[..., k, None], effort)
                effort = np.where(held == -FORCE - k, least[..., k, None], effort)
        force = values[..., 1] + values[..., 2] * v**2 + values[..., 3] * v + (values[..., 4:] * effort).sum(axis=-1)
        return effort, force / values[..., 0]

    def keeps(self, s: np.ndarray, v: np.ndarray, *, towards: bool) -> bool:
        """Return whether one effort keeps all limits at places and speeds (n,): where none does, no motion is that fast."""
        if self.pins is None:
            return True
        _, effort, _ = self.at(s, v, towards=towards)
        least, most, bears = self.pins.efforts(s, v)
        room = _KEPT * np.abs(self.effort).max()
        low, high = np.maximum(self.effort[:, 0], least.max(axis=-1)[:, None]), self.effort[:, 1]
        high = np.minimum(high, most.min(axis=-1)[:, None])
        spent = effort * self.curves(s)[:, 4:] * v[:, None]
        powers = (spent <= (1 + _KEPT) * self.power[:, 1]) & (spent >= (1 + _KEPT) * self.power[:, 0])
        return bool(np.all(bears) and np.all((effort >= low - room) & (effort <= high + room)) and np.all(powers))
