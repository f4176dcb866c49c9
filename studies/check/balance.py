"""Poses in balance along a path of `linkplan check`, where weight, springs and constant forces need no effort.

t(s) = Gamma^T (g - springs - forces) is the effort that holds the swept coordinate. A pose with t = 0 is in balance, stable
if dt/ds > 0.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.sign_change import sign_change

# An effort is zero at a root if it is less than this share of the largest effort nearby. This excludes poles, at which the
# effort changes its sign through infinity.
_ZERO_SHARE = 1e-6


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Balance:
    """A pose in balance: the coordinate's position [rad or m], and whether it returns there."""

    position: float
    stable: bool


def balances(mechanism: Mechanism, poses: np.ndarray, needed: np.ndarray, coordinate: int) -> tuple[Balance, ...]:
    """Return the poses in balance between neighbouring poses (n, n_q) of a coordinate's path, by position.

    Args:
        mechanism: of the path.
        poses: along it.
        needed: the effort (n,) on the coordinate that holds them at rest.
        coordinate: the swept independent joint's column.
    """
    largest = float(np.abs(needed[np.isfinite(needed)]).max(initial=0.0))
    found: dict[float, Balance] = {}
    for k in np.flatnonzero(needed[:-1] * needed[1:] <= 0):
        ends, (low, high) = np.abs(needed[k : k + 2]), poses[k : k + 2, mechanism.independent]
        if not ROUNDING_SHARE * largest < ends.max():  # no effort is needed on a whole interval
            continue

        def effort(share: Any, low: np.ndarray = low, high: np.ndarray = high, begin: np.ndarray = poses[k]) -> float:
            return _needed(mechanism, low + float(share) * (high - low), begin)[coordinate]

        try:
            share = float(sign_change(effort, 0.0, 1.0, 1e-12))
            rest = abs(effort(share))
        except AssemblyError:
            continue
        step = high[coordinate] - low[coordinate]
        if np.isfinite(share) and rest <= _ZERO_SHARE * ends.max() and step:
            position = float(low[coordinate] + share * step)
            found[round(position, 9)] = Balance(position=position, stable=bool((needed[k + 1] - needed[k]) / step > 0))
    return tuple(found[position] for position in sorted(found))


def _needed(mechanism: Mechanism, s: np.ndarray, begin: np.ndarray) -> np.ndarray:
    """Return the effort (n_s,) on each coordinate that holds positions s (n_s,) at rest, on the branch of a pose (n_q,)."""
    poses, still = follow(mechanism, s[None], begin), np.zeros((1, mechanism.dof))
    return sampled(mechanism.dynamics.inverse_dynamics, poses, still, still)[0, :, 0]
