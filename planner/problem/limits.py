"""Limits at every instant of a motion, and the motors that some limits come from."""

from dataclasses import dataclass

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.planner.problem.sites import SiteLimit


def free_bounds(n: int) -> np.ndarray:
    """Return infinite [low, high] rows (n, 2)."""
    return np.tile([-np.inf, np.inf], (n, 1))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Motor:
    """An electric motor behind an actuator, in the actuator's own effort and speed.

    `torque_constant` [N.m/A or N/A] and `resistance` [ohm] give the copper loss R (u / k)^2; `stall_effort` [N.m or N] and
    `no_load_speed` [rad/s or m/s] give the line |u / stall + w / no_load| <= 1 with the actuator's speed w. None if unknown.
    """

    torque_constant: float | None = None
    resistance: float | None = None
    stall_effort: float | None = None
    no_load_speed: float | None = None

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise ProblemError(f"motors.{name} is a positive number, got {value!r}")
        for one, other in (("torque_constant", "resistance"), ("stall_effort", "no_load_speed")):
            if (getattr(self, one) is None) != (getattr(self, other) is None):
                raise ProblemError(f"a motor's {one} and {other} go together, got one of them alone")

    @property
    def has_line(self) -> bool:
        """Whether its torque-speed line is known."""
        return self.stall_effort is not None

    @property
    def loss(self) -> float:
        """Copper loss per squared effort, R / k^2; 0 where unknown."""
        return 0.0 if self.torque_constant is None else self.resistance / self.torque_constant**2


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Limits:
    """Limits at every instant as rows [low, high], infinite without a limit.

    `effort` (n_u, 2) [N.m or N]; `position` and `speed` (n_q, 2) [rad or m, and per second] of all joints; `effort_rate`
    (n_u, 2) [N.m/s or N/s]; `power` (n_u, 2) [W], mechanical, of each actuator; `closure_force` (n_closures,) [N], the
    largest force of each closure; `singular_margin`, the least |det J_z| relative to home; `site`, limits on sites [m].
    `effort` is the limit for plans: `reserve` is the share of the actuators' own limits that is left to feedback.
    """

    effort: np.ndarray
    position: np.ndarray
    speed: np.ndarray
    effort_rate: np.ndarray | None = None
    power: np.ndarray | None = None
    closure_force: np.ndarray | None = None
    singular_margin: float = 0.0
    reserve: float = 0.0
    site: tuple[SiteLimit, ...] = ()

    def __post_init__(self) -> None:
        n_u = len(self.effort)
        object.__setattr__(self, "site", tuple(self.site))
        for name in ("effort_rate", "power"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, free_bounds(n_u))
        if self.closure_force is None:
            object.__setattr__(self, "closure_force", np.zeros(0))
        for name in ("effort", "position", "speed", "effort_rate", "power"):
            value = np.array(getattr(self, name), dtype=float)
            if value.ndim != 2 or value.shape[1] != 2 or np.any(np.isnan(value)):
                raise ProblemError(f"limits.{name} has one [low, high] a row, got shape {value.shape}")
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        force = np.array(self.closure_force, dtype=float)
        if np.any(np.isnan(force)) or np.any(force <= 0):
            raise ProblemError(f"limits.closure_force is positive, got {force}")
        force.flags.writeable = False
        object.__setattr__(self, "closure_force", force)
        if not 0 <= self.reserve < 1:
            raise ProblemError(f"limits.reserve is from 0 to below 1, got {self.reserve!r}")
        if not 0 <= self.singular_margin < 1:
            raise ProblemError(f"limits.singular_margin is from 0 to below 1, got {self.singular_margin!r}")

    @property
    def actuators_effort(self) -> np.ndarray:
        """The actuators' own limits (n_u, 2) [N.m or N], including the reserve that plans leave to feedback."""
        return self.effort / (1.0 - self.reserve)

    @property
    def limited_closures(self) -> tuple[int, ...]:
        """The closures with a limited force."""
        return tuple(int(i) for i in np.flatnonzero(np.isfinite(self.closure_force)))
