"""Ranges of what is not known of a machine, over whose every corner a plan keeps its effort limits.

One motion for all machines within the ranges: each needs efforts of its own for it, by inverse dynamics,

    u_c = (Gamma^T B)^-1 (tau(s, v, a; payload) + Gamma^T (d q' + c sign)) / k,

which are affine in payload factor, viscous friction d and Coulomb friction c, and monotone in the factor k on the torque
constant: limits that hold at the corners hold throughout. With more actuators than degrees of freedom the same holds of the
plan's efforts and the least ones that make up for the difference, u_c = u + (Gamma^T B)^+ (... / k - Gamma^T B u). With
fewer it holds of ranges that the actuators can make up for: torque constants, friction at joints that they drive.
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from linkplan.models.errors import ProblemError

# More corners than this are more rows at every node than a plan should take.
MOST_CORNERS = 64
Range = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Corner:
    """A machine at the ends of the ranges: factors, and (joint, viscous [N.m.s/rad], Coulomb [N.m], signed) frictions."""

    payload_factor: float = 1.0
    torque_factor: float = 1.0
    friction: tuple[tuple[int, float, float], ...] = ()

    def said(self, joints: tuple[str, ...]) -> str:
        """Return the corner in words."""
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
    """Ranges [low, high]: factors on payload and torque constant; by joint's index, viscous and Coulomb friction.

    Friction is [N.m.s/rad or N.s/m] and [N.m or N].
    """

    payload_factor: Range = (1.0, 1.0)
    torque_factor: Range = (1.0, 1.0)
    viscous: Mapping[int, Range] = field(default_factory=dict)
    coulomb: Mapping[int, Range] = field(default_factory=dict)
    room: float = 1.0  # a factor on effort limits at the corners: what a diagnosis widens

    def __post_init__(self) -> None:
        for name in ("payload_factor", "torque_factor"):
            low, high = getattr(self, name)
            if not 0 < low <= high < np.inf:
                raise ProblemError(f"robust.{name} is [low, high] of positive factors, got [{low:g}, {high:g}]")
        for name in ("viscous", "coulomb"):
            for low, high in getattr(self, name).values():
                if not 0 <= low <= high < np.inf:
                    raise ProblemError(f"robust.{name} is [low, high] from zero on, got [{low:g}, {high:g}]")
        if len(self.corners) > MOST_CORNERS:
            raise ProblemError(f"[robust] has {len(self.corners)} corners; at most {MOST_CORNERS} are kept")

    @property
    def corners(self) -> tuple[Corner, ...]:
        """Every corner but the machine as modelled, whose efforts are the plan's own."""
        choices = []
        for joint in sorted({*self.viscous, *self.coulomb}):
            most = self.coulomb.get(joint, (0.0, 0.0))[1]  # against the motion or with it: whichever is worse
            signs = sorted({-most, most})
            choices.append([(joint, d, c) for d in sorted({*self.viscous.get(joint, (0.0, 0.0))}) for c in signs])
        found = itertools.product(sorted({*self.payload_factor}), sorted({*self.torque_factor}), *choices)
        corners = (Corner(payload_factor=p, torque_factor=k, friction=tuple(rubbing)) for p, k, *rubbing in found)
        return tuple(one for one in corners if (one.payload_factor, one.torque_factor) != (1.0, 1.0) or _rubs(one))


def _rubs(corner: Corner) -> bool:
    return any(d or c for _, d, c in corner.friction)
