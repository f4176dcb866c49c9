"""One instant of a motion as CasADi expressions in SI, and a program's units.

Limits and running costs are written in these expressions.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.tree.joints import unit_steps
from linkplan.planner.problem.robust import Corner, corner_efforts


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Scales:
    """Units in which the unknowns are of order one.

    `time_s` [s], `position` (n_s,) [rad or m], `effort` (n_u,) and `residual` (n_s,), of generalised efforts, [N.m or N],
    `length_m` of the closure [m].
    """

    time_s: float
    position: np.ndarray
    effort: np.ndarray
    residual: np.ndarray
    length_m: float

    @property
    def power(self) -> float:
        """The unit of power [W]."""
        return float((self.residual * self.position).max()) / self.time_s

    @property
    def force(self) -> float:
        """The unit of closure forces [N]."""
        return float(self.residual.max()) / self.length_m

    def vector(self) -> np.ndarray:
        """Return the scales as parameters of a node."""
        units = [self.length_m, self.power, self.force]
        return np.concatenate([[self.time_s], self.position, self.effort, self.residual, units])


def position_units(mechanism: Mechanism, positions: np.ndarray) -> np.ndarray:
    """Return the spans (n_s,) of positions (..., n_s); of joints at rest, 1 rad or the mechanism's extent [rad or m]."""
    unit = unit_steps(mechanism.independent_joints, mechanism.extent_m)
    span = np.ptp(positions.reshape(-1, mechanism.dof), axis=0)
    return np.where(span > 1e-3 * unit, span, unit)


@dataclass(frozen=True, eq=False, kw_only=True)
class Instant:
    """A pose, its motion and its efforts; derived quantities are built once, when they are first used.

    Args:
        mechanism: the mechanism.
        q, v, a, u: pose (n_q,), independent speeds and accelerations (n_s,), efforts (n_u,).
        payload: numbers (7,) of the payload; empty without a payload.
        call: calls the reduced dynamics' functions by name.
        units: the program's units by name: time, position, effort, residual, length, power, force.
        rates: rates (n_q,) of all joints if they are unknowns of the program; otherwise they follow from the loops.
        reference: independent positions (n_s,) that are tracked.
        effort_rate: u' (n_u,).
        losses: copper loss per squared effort (n_u,) of the motors.
        positive_power: of each actuator (n_u,) if it is an unknown of the program; otherwise max(0, u w).
    """

    mechanism: Mechanism
    q: ca.SX
    v: ca.SX
    a: ca.SX
    u: ca.SX
    payload: ca.SX
    call: Callable[..., ca.SX]
    units: Mapping[str, ca.SX] = field(default_factory=dict)
    rates: ca.SX | None = None
    reference: ca.SX | None = None
    effort_rate: Any = None
    losses: Any = None
    positive_power: ca.SX | None = None
    _kept: dict = field(default_factory=dict)

    @cached_property
    def joint_rates(self) -> ca.SX:
        """The rates (n_q,) of all joints."""
        return self.call("velocity_map", self.q) @ self.v if self.rates is None else self.rates

    def of_pose(self, name: str) -> ca.SX:
        """Return the value of a function of the reduced dynamics that depends on the pose only."""
        if name not in self._kept:
            self._kept[name] = self.call(name, self.q)
        return self._kept[name]

    @cached_property
    def actuator_speeds(self) -> ca.SX:
        """The actuators' speeds (n_u,)."""
        if self.rates is None:
            return self.of_pose("effort_map").T @ self.v
        return self.call("effort_matrix", self.q).T @ self.rates

    @cached_property
    def closure_force(self) -> ca.SX:
        """The forces of all closures, one after another [N]."""
        return self.call("closure_force", self.q, self.v, self.a, self.u)

    @cached_property
    def positive_powers(self) -> ca.SX:
        """The actuators' positive powers (n_u,) [W]."""
        return ca.fmax(0, self.u * self.actuator_speeds) if self.positive_power is None else self.positive_power

    def corner_efforts(self, corners: Sequence[Corner]) -> list[ca.SX]:
        """Return the efforts (n_u,) that the motion needs at each corner of the ranges in [robust]."""
        key = tuple(corners)
        if key not in self._kept:
            motion = (self.q, self.v, self.a, self.u)
            self._kept[key] = corner_efforts(self.mechanism, key, self.call, self.payload, motion)
        return self._kept[key]


def free_instant(mechanism: Mechanism, losses: np.ndarray | None = None) -> tuple[Instant, list[ca.SX]]:
    """Return an instant of new symbols, and the symbols: q, v, a, u, the effort's rate, the reference."""
    sizes = {"q": mechanism.n_q, "v": mechanism.dof, "a": mechanism.dof, "u": mechanism.n_u}
    symbols = [ca.SX.sym(name, size) for name, size in (sizes | {"rate": mechanism.n_u, "reference": mechanism.dof}).items()]
    q, v, a, u, rate, reference = symbols
    payload = ca.SX(0, 1) if mechanism.payload is None else ca.SX(mechanism.payload.numbers())

    def call(name: str, *arguments: Any) -> ca.SX:
        return getattr(mechanism.dynamics, name)(*arguments)

    given = {"effort_rate": rate, "reference": reference, "losses": losses}
    return Instant(mechanism=mechanism, q=q, v=v, a=a, u=u, payload=payload, call=call, **given), symbols
