"""Ranges of a machine's uncertain parameters, at every corner of which a plan keeps its effort limits.

All machines within the ranges follow one motion. Each needs its own efforts, by inverse dynamics,

    u_c = (Gamma^T B)^-1 (tau(s, v, a; payload) + Gamma^T (d q' + c sign)) / k,

which are affine in the payload factor, the viscous friction d and the Coulomb friction c, and monotone in the torque
constant's factor k. Limits that hold at the corners therefore hold throughout the ranges. With more actuators than degrees
of freedom the same holds for the plan's efforts plus the least compensating ones, u_c = u + (Gamma^T B)^+ (... / k - Gamma^T
B u). With fewer actuators it holds for ranges that actuators can compensate: torque constants, friction at driven joints.
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from linkplan.models.errors import ProblemError

# More corners would give too many rows at every node.
MAX_CORNERS = 64
Range = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Corner:
    """A machine at a corner of the ranges: factors, and frictions (joint, viscous [N.m.s/rad], signed Coulomb [N.m])."""

    payload_factor: float = 1.0
    torque_factor: float = 1.0
    friction: tuple[tuple[int, float, float], ...] = ()

    def description(self, joints: tuple[str, ...]) -> str:
        """Return a phrase that describes the corner."""
        words = []
        if self.payload_factor != 1:
            words.append(f"payload {self.payload_factor:g}")
        if self.torque_factor != 1:
            words.append(f"torque constant {self.torque_factor:g}")
        for joint, viscous, coulomb in self.friction:
            words.append(f"{joints[joint]} rubbing {viscous:g} v {coulomb:+g}")
        return ", ".join(words) or "as modelled"


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Robust:
    """Ranges [low, high]: factors on payload and torque constant; viscous and Coulomb friction by joint index.

    Friction is [N.m.s/rad or N.s/m] and [N.m or N].
    """

    payload_factor: Range = (1.0, 1.0)
    torque_factor: Range = (1.0, 1.0)
    viscous: Mapping[int, Range] = field(default_factory=dict)
    coulomb: Mapping[int, Range] = field(default_factory=dict)
    room: float = 1.0  # a factor on effort limits at the corners, which a diagnosis increases

    def __post_init__(self) -> None:
        for name in ("payload_factor", "torque_factor"):
            low, high = getattr(self, name)
            if not 0 < low <= high < np.inf:
                raise ProblemError(f"robust.{name} is [low, high] of positive factors, got [{low:g}, {high:g}]")
        for name in ("viscous", "coulomb"):
            for low, high in getattr(self, name).values():
                if not 0 <= low <= high < np.inf:
                    raise ProblemError(f"robust.{name} is [low, high] from zero on, got [{low:g}, {high:g}]")
        if len(self.corners) > MAX_CORNERS:
            raise ProblemError(f"[robust] has {len(self.corners)} corners; at most {MAX_CORNERS} are kept")

    @property
    def corners(self) -> tuple[Corner, ...]:
        """All corners except the nominal machine, whose efforts are the plan's own."""
        choices = []
        for joint in sorted({*self.viscous, *self.coulomb}):
            most = self.coulomb.get(joint, (0.0, 0.0))[1]  # of either sign
            signs = sorted({-most, most})
            choices.append([(joint, d, c) for d in sorted({*self.viscous.get(joint, (0.0, 0.0))}) for c in signs])
        rubbing = itertools.product(*choices)
        found = itertools.product(sorted({*self.payload_factor}), sorted({*self.torque_factor}), rubbing)
        corners = (Corner(payload_factor=p, torque_factor=k, friction=tuple(one)) for p, k, one in found)
        return tuple(one for one in corners if (one.payload_factor, one.torque_factor) != (1.0, 1.0) or _rubs(one))


def _rubs(corner: Corner) -> bool:
    return any(d or c for _, d, c in corner.friction)
