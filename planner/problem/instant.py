"""One instant of a motion as CasADi expressions in SI, a program's units, and ranges of a machine's parameters.

Limits and running costs are written in these expressions.

All machines within the ranges of `Robust` follow one motion. Each needs its own efforts, by inverse dynamics, which are
affine in the payload factor, the viscous friction d and the Coulomb friction c, and monotone in the torque constant's factor
k. Limits that hold at the corners therefore hold throughout the ranges. With more actuators than degrees of freedom the same
holds for the plan's efforts plus the least compensating ones, u_c = u + (Gamma^T B)^+ (... / k - Gamma^T B u). With fewer
actuators it holds for ranges that actuators can compensate: torque constants, friction at driven joints.
"""

import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from linkplan.models.actuation.distribution import UNLIMITED, actuator_sizes, distribute
from linkplan.models.errors import AssemblyError, ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.parameters import is_payload_s_weight
from linkplan.models.poses.along import is_redundant, joint_acceleration, joint_jerk, sampled, site_derivative
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.joint_forces import joint_loads
from linkplan.models.reduction.reduced import ReducedDynamics
from linkplan.models.tree.joints import unit_steps
from linkplan.planner.problem.keys.limits import RobustSection

# More corners would give too many rows at every node.
MAX_CORNERS = 64


@dataclass(frozen=True, slots=True, kw_only=True)
class Corner:
    """A machine at a corner of the ranges: factors, and frictions (joint, viscous [N.m.s/rad], signed Coulomb [N.m]).

    `named` are values [SI] of the mechanism's parameters by name.
    """

    payload_factor: float = 1.0
    torque_factor: float = 1.0
    friction: tuple[tuple[str, float, float], ...] = ()
    named: tuple[tuple[str, float], ...] = ()

    @property
    def description(self) -> str:
        """A phrase that describes the corner."""
        words = []
        if self.payload_factor != 1:
            words.append(f"payload {self.payload_factor:g}")
        if self.torque_factor != 1:
            words.append(f"torque constant {self.torque_factor:g}")
        words += [f"{joint} rubbing {viscous:g} v {coulomb:+g}" for joint, viscous, coulomb in self.friction]
        words += [f"{name} {value:g}" for name, value in self.named]
        return ", ".join(words) or "nominal"

    @property
    def changes_parameters(self) -> bool:
        """Whether the corner's machine has other parameters than the nominal one."""
        return self.payload_factor != 1.0 or bool(self.named)

    def parameters(self, mechanism: Mechanism, nominal: Any) -> list:
        """Return the parameters (n,) at the corner, from the nominal ones (n,), numbers or symbols [SI]."""
        factors = (self.payload_factor if is_payload_s_weight(one.name) else 1.0 for one in mechanism.parameters)
        every = enumerate(zip(mechanism.parameters, factors, strict=True))
        return [dict(self.named).get(one.name, factor * nominal[k]) for k, (one, factor) in every]


class Robust(RobustSection, frozen=True, eq=False):
    """The [robust] of a problem."""

    room: float = 1.0  # a factor on effort limits at the corners, which a diagnosis increases
    box: tuple[tuple[str, float, float], ...] = ()  # the named parameters with the ends of their ranges [SI]

    def __post_init__(self) -> None:
        factors = {name: getattr(self, name) for name in ("payload_factor", "torque_constant_factor")}
        tables = {name: getattr(self, name) for name in ("viscous_friction", "coulomb_friction")}
        frictions = {f"{name}.{joint}": ends for name, table in tables.items() for joint, ends in table.items()}
        for name, (low, high) in (factors | frictions).items():
            if not (low > 0 if name in factors else low >= 0) or not low <= high < np.inf:
                legal = "of positive factors" if name in factors else "from zero on"
                raise ProblemError(f"robust.{name} must be [low, high] {legal} with low <= high, got [{low:g}, {high:g}]")
        if len(self.corners) > MAX_CORNERS:
            raise ProblemError(f"[robust] has {len(self.corners)} corners; the limit is {MAX_CORNERS}")

    @property
    def corners(self) -> tuple[Corner, ...]:
        """All corners except the nominal machine, whose efforts are the plan's own."""
        choices = []
        for joint in sorted({*self.viscous_friction, *self.coulomb_friction}):
            most = self.coulomb_friction.get(joint, (0.0, 0.0))[1]  # one corner for each sign
            signs = sorted({-most, most})
            viscous = sorted({*self.viscous_friction.get(joint, (0.0, 0.0))})
            choices.append([(joint, d, c) for d in viscous for c in signs])
        factors = (sorted({*self.payload_factor}), sorted({*self.torque_constant_factor}))
        named = [[(name, end) for end in sorted({low, high})] for name, low, high in self.box]
        found = itertools.product(*factors, itertools.product(*choices), itertools.product(*named))
        corners = (Corner(payload_factor=p, torque_factor=k, friction=one, named=at) for p, k, one, at in found)
        return tuple(one for one in corners if one.changes_parameters or one.torque_factor != 1.0 or _rubs(one))


def _rubs(corner: Corner) -> bool:
    return any(d or c for _, d, c in corner.friction)


def _needed(at: "Instant", corners: Sequence[Corner]) -> list[ca.SX]:
    """Return the generalised efforts (n_s,) of an instant's motion at each corner, before division by the torque factor."""
    gamma = at.call("velocity_map", at.q)
    rates = gamma @ at.v
    modelled: dict[Corner, ca.SX] = {}
    found = []
    for corner in corners:
        machine = Corner(payload_factor=corner.payload_factor, named=corner.named)
        if machine not in modelled:
            if machine.changes_parameters:
                parameters = ca.vertcat(*machine.parameters(at.mechanism, at.parameters), at.forces)
                modelled[machine] = at.mechanism.parametric_dynamics().inverse_dynamics(at.q, at.v, at.a, parameters)
            else:
                modelled[machine] = at.call("inverse_dynamics", at.q, at.v, at.a)
        tau = modelled[machine]
        for name, viscous, coulomb in corner.friction:
            joint = at.mechanism.joint_index(name)
            tau = tau + gamma[joint, :].T * (viscous * rates[joint] + coulomb)
        found.append(tau)
    return found


def near_home(mechanism: Mechanism) -> list[np.ndarray]:
    """Return home and a pose (n_q,) close to it, because home may be at a dead centre."""
    beside = mechanism.home[mechanism.independent] + 0.05 * np.random.default_rng(0).normal(size=mechanism.dof)
    try:
        return [mechanism.home, close_at(mechanism, beside, mechanism.home)]
    except AssemblyError:
        return [mechanism.home]


def corner_out_of_reach(mechanism: Mechanism, corners: Sequence[Corner]) -> Corner | None:
    """Return the first corner whose difference actuators cannot compensate; None if they can compensate all.

    The criterion is (1 - P P^+) (tau_c - tau) = 0 with P = Gamma^T B, for random motions at home and at a pose close to it.
    """
    at, symbols = free_instant(mechanism)
    needed = ca.horzcat(*_needed(at, (Corner(), *corners)))
    # The forces over time are the same for all machines, and cancel.
    needed = ca.substitute(needed, at.forces, ca.SX.zeros(*at.forces.shape))
    function = ca.Function("needed", symbols[:3], [ca.densify(needed)])
    rng = np.random.default_rng(1)
    for q in near_home(mechanism):
        P = np.array(mechanism.dynamics.effort_map(q))
        needed = np.array(function(q, *rng.normal(size=(2, mechanism.dof))))
        added = needed[:, 1:] - needed[:, :1]
        left = added - P @ (np.linalg.pinv(P) @ added)
        for column, corner in enumerate(corners):
            if np.abs(left[:, column]).max() > 1e-9 * np.abs(needed).max():
                return corner
    return None


def corner_efforts_along(mechanism: Mechanism, corners: tuple[Corner, ...], q, v, a, u, *forces: np.ndarray) -> np.ndarray:
    """Return each corner's efforts (n, n_corners, n_u) [N.m or N] along samples q (n, n_q), v, a (n, n_s), u (n, n_u).

    `forces` are those of `Mechanism.forces_at`.
    """
    taus, maps = corner_demands_along(mechanism, corners, q, v, a, *forces), sampled(mechanism.dynamics.effort_map, q)
    size = actuator_sizes(mechanism.effort_limit)
    return np.stack([size * distribute(taus[:, k], maps * size, UNLIMITED, u / size) for k in range(len(corners))], axis=1)


def corner_demands_along(mechanism: Mechanism, corners: tuple[Corner, ...], q, v, a, *forces: np.ndarray) -> np.ndarray:
    """Return generalised efforts (n, n_corners, n_s), over the torque factor, along samples as `corner_efforts_along`."""
    return sampled(_function(mechanism, corners), q, v, a, *forces).reshape(len(q), len(corners), mechanism.dof)


@functools.lru_cache(maxsize=16)
def _function(mechanism: Mechanism, corners: tuple[Corner, ...]) -> ca.Function:
    at, symbols = free_instant(mechanism)
    taus = [tau / corner.torque_factor for tau, corner in zip(_needed(at, corners), corners, strict=True)]
    return ca.Function("corners", [*symbols[:3], *force_inputs(at)], [ca.densify(ca.vertcat(*taus))])


def with_parameters(dynamics: ReducedDynamics, parameters: ca.SX) -> Callable[..., ca.SX]:
    """Return a function that calls reduced dynamics by name, with parameters as the last input of functions that take it."""

    def call(name: str, *arguments: Any) -> ca.SX:
        function = getattr(dynamics, name)
        return function(*arguments, *([parameters] if function.n_in() > len(arguments) else []))

    return call


def force_inputs(at: "Instant") -> list[ca.SX]:
    """Return the symbols of an instant's forces over time as the last inputs of a function, as `Mechanism.forces_at`."""
    return [] if at.mechanism.forces is None else [at.forces]


def motion_symbols(at: "Instant") -> list[ca.SX]:
    """Return the symbols q, v, a, u and the jerk of an instant as inputs of a function, and `force_inputs`."""
    return [at.q, at.v, at.a, at.u, at.jerk, *force_inputs(at)]


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


def unit_scales(mechanism: Mechanism) -> Scales:
    """Return the scales of unknowns in SI."""
    ones, efforts = np.ones(mechanism.dof), np.ones(mechanism.n_u)
    return Scales(time_s=1.0, position=ones, effort=efforts, residual=ones, length_m=1.0)


def position_units(mechanism: Mechanism, positions: np.ndarray) -> np.ndarray:
    """Return the spans (n_s,) of positions (..., n_s) [rad or m]; for joints at rest, 1 rad or the mechanism's extent."""
    unit = unit_steps(mechanism.independent_joints, mechanism.extent_m)
    span = np.ptp(positions.reshape(-1, mechanism.dof), axis=0)
    return np.where(span > 1e-3 * unit, span, unit)


@dataclass(frozen=True, eq=False, kw_only=True)
class Instant:
    """A pose, its motion and its efforts; derived quantities are built once, when they are first used.

    Args:
        mechanism: the mechanism.
        q, v, a, u: pose (n_q,), independent speeds and accelerations (n_s,), efforts (n_u,).
        parameters: of the mechanism (n,).
        forces: those over time (3 n_sites,) [N] in the world; empty without any.
        call: calls the reduced dynamics' functions by name.
        units: the program's units by name: time, position, effort, residual, length, power, force.
        rates, accelerations, jerks: of all joints (n_q,), and `multipliers` (rank,) [N] of the independent closure
            equations, if they are unknowns of the node; otherwise they are solved from the loops where they are used.
        reference: independent positions (n_s,) that are tracked.
        effort_rate, jerk: u' (n_u,) and a' (n_s,), if they are known.
        losses: copper loss per squared effort (n_u,) of the motors.
        positive_power: of each actuator (n_u,) if it is an unknown of the program; otherwise max(0, u w).
    """

    mechanism: Mechanism
    q: ca.SX
    v: ca.SX
    a: ca.SX
    u: ca.SX
    parameters: ca.SX
    forces: ca.SX
    call: Callable[..., ca.SX]
    units: Mapping[str, ca.SX] = field(default_factory=dict)
    rates: ca.SX | None = None
    accelerations: ca.SX | None = None
    jerks: ca.SX | None = None
    multipliers: ca.SX | None = None
    reference: ca.SX | None = None
    effort_rate: Any = None
    jerk: Any = None
    losses: Any = None
    positive_power: ca.SX | None = None
    _kept: dict = field(default_factory=dict)

    @cached_property
    def joint_rates(self) -> ca.SX:
        """The rates (n_q,) of all joints."""
        return self.call("velocity_map", self.q) @ self.v if self.rates is None else self.rates

    @cached_property
    def joint_accelerations(self) -> ca.SX:
        """The accelerations (n_q,) of all joints."""
        if self.accelerations is None:
            return joint_acceleration(self.mechanism)(self.q, self.v, self.a)
        return self.accelerations

    @cached_property
    def joint_jerks(self) -> ca.SX:
        """The jerks (n_q,) of all joints."""
        return joint_jerk(self.mechanism)(self.q, self.v, self.a, self.jerk) if self.jerks is None else self.jerks

    @cached_property
    def site_velocities(self) -> ca.SX:
        """The velocities (3, n_sites) of the model's sites in the world."""
        return site_derivative(self.mechanism, 1)(self.q, self.joint_rates)

    @cached_property
    def site_accelerations(self) -> ca.SX:
        """The accelerations (3, n_sites) of the model's sites in the world."""
        return site_derivative(self.mechanism, 2)(self.q, self.joint_rates, self.joint_accelerations)

    @cached_property
    def site_jerks(self) -> ca.SX:
        """The jerks (3, n_sites) of the model's sites in the world."""
        of_joints = self.joint_rates, self.joint_accelerations, self.joint_jerks
        return site_derivative(self.mechanism, 3)(self.q, *of_joints)

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
        if self.multipliers is None:
            return self.call("closure_force", self.q, self.v, self.a, self.u)
        return self.of_pose("force_map") @ self.multipliers

    @cached_property
    def joint_loads(self) -> ca.SX:
        """The loads (6, 1 + n_pins) [N, N.m] on the frame and in the pins of the tree, by the function `joint_loads`."""
        motion = self.q, self.joint_rates, self.joint_accelerations
        return joint_loads(self.mechanism)(*motion, self.closure_force, self.u, ca.vertcat(self.parameters, self.forces))

    @cached_property
    def positive_powers(self) -> ca.SX:
        """The actuators' positive powers (n_u,) [W]."""
        return ca.fmax(0, self.u * self.actuator_speeds) if self.positive_power is None else self.positive_power

    def corner_efforts(self, corners: Sequence[Corner]) -> list[ca.SX]:
        """Return the efforts (n_u,) that the motion needs at each corner of the ranges in [robust].

        With more actuators than degrees of freedom, many efforts give one motion. A corner then needs the plan's efforts
        plus the least efforts, in units S of the limits, that compensate the difference: u_c = u + S (R S)^+ (tau_c / k -
        R u) with R = Gamma^T B. With fewer actuators, the corner must differ only by what actuators can compensate:
        friction at driven joints and the torque constant (`corner_out_of_reach`). The same expression gives these efforts,
        since (R S)^+ R S = 1.
        """
        key = tuple(corners)
        if key not in self._kept:
            effort_map, found = self.call("effort_map", self.q), []
            for corner, tau in zip(key, _needed(self, key), strict=True):
                if self.mechanism.n_u == self.mechanism.dof and not is_redundant(self.mechanism):
                    found.append(ca.solve(effort_map, tau) / corner.torque_factor)
                else:
                    size = ca.diag(ca.DM(actuator_sizes(self.mechanism.effort_limit)))
                    added = ca.pinv(effort_map @ size) @ (tau / corner.torque_factor - effort_map @ self.u)
                    found.append(self.u + size @ added)
            self._kept[key] = found
        return self._kept[key]


def free_instant(mechanism: Mechanism, losses: np.ndarray | None = None) -> tuple[Instant, list[ca.SX]]:
    """Return an instant of new symbols, and the symbols: q, v, a, u, the effort's rate, the reference, the jerk.

    Forces over time are further symbols, which `force_inputs` has.
    """
    sizes = {"q": mechanism.n_q, "v": mechanism.dof, "a": mechanism.dof, "u": mechanism.n_u}
    sizes |= {"rate": mechanism.n_u, "reference": mechanism.dof, "jerk": mechanism.dof}
    symbols = [ca.SX.sym(name, size) for name, size in sizes.items()]
    q, v, a, u, rate, reference, jerk = symbols
    parameters = ca.SX(ca.DM(mechanism.parameter_values))
    forces = ca.SX.sym("forces", 0 if mechanism.forces is None else 3 * len(mechanism.forces.sites))
    call = with_parameters(mechanism.forced, forces)
    given = {"effort_rate": rate, "jerk": jerk, "reference": reference, "losses": losses}
    given |= {"parameters": parameters, "forces": forces, "call": call}
    return Instant(mechanism=mechanism, q=q, v=v, a=a, u=u, **given), symbols


def jerk_columns(at: Instant, value: ca.SX) -> tuple[int, ...]:
    """Return the independent coordinates on whose jerk an expression of a `free_instant` depends."""
    return tuple(k for k in range(at.mechanism.dof) if ca.depends_on(value, at.jerk[k]))
