"""A mechanism as a system for the transcription: closure and reduced dynamics at a node, all scaled.

Second-order coordinates are the independent joints. Algebraic unknowns are the dependent ones (lifted: tied by phi(s, z)
= 0) and, where positive work costs, each actuator's positive power (P >= u w, P >= 0: exact, with no kink in the program);
where power is limited at every instant, the levers of actuators on coordinates that they do not drive themselves; where pin
force is, the force, in shares of its rating.
Equations: phi(q) / length and (inverse_dynamics(q, v, a) - Gamma^T B u) / scale. Path quantities: what limits ask for beyond
the bounds of the unknowns themselves.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.models.actuation.actuators import ranged_control
from linkplan.models.mechanism import Mechanism
from linkplan.planner.closed_chain.lifted import in_order, is_lifted, lifted_rows, n_lifted
from linkplan.planner.closed_chain.site_rows import TUBE, site_row
from linkplan.planner.problem.corner_efforts import corner_efforts
from linkplan.planner.problem.robust import Corner
from linkplan.planner.transcription.system import NodeSymbols, System, node_symbols

# Terms of an objective that are integrals of a quantity at nodes.
RUNNING = ("tracking", "work", "closure_force")
# Path quantities that jump where the effort does.
WITH_EFFORT = ("motor", "power", "closure_force", "control", "robust")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Scales:
    """Units in which the unknowns are of order one.

    `time_s` [s], `position` (n_s,) [rad or m], `effort` (n_u,) and `residual` (n_s,), the generalised effort's, [N.m or N],
    `length_m` the closure's [m].
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


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeTerms:
    """What is looked at in a node, the structure of its functions: running costs out of `RUNNING`, and path quantities.

    `speed_joints` are dependent joints, `motors` and `powers` actuators, `levers` pairs (actuator, independent column)
    whose entry of the effort map is an algebraic unknown, `closures` those whose force is limited, `bearing` those of
    them whose force is an algebraic unknown; `singular`
    is the number of blocks of J_z whose determinants are; `controls` are servos whose ctrl is; `tendons` are places in
    `Mechanism.tendons`; `sites` are `SiteLimit.key`s; `corners` are machines whose `n_u` efforts each are limited.
    """

    running: tuple[str, ...] = ()
    speed_joints: tuple[int, ...] = ()
    motors: tuple[int, ...] = ()
    powers: tuple[int, ...] = ()
    levers: tuple[tuple[int, int], ...] = ()
    closures: tuple[int, ...] = ()
    bearing: tuple[int, ...] = ()
    singular: int = 0
    controls: tuple[int, ...] = ()
    tendons: tuple[int, ...] = ()
    sites: tuple[tuple, ...] = ()
    corners: tuple[Corner, ...] = ()
    n_u: int = 0

    @property
    def kinds(self) -> tuple[str, ...]:
        """What each path quantity is, but for those of the objective."""
        listed = {"speed": self.speed_joints, "motor": self.motors, "power": self.powers, "closure_force": self.closures}
        named = tuple(kind for kind, items in listed.items() for _ in items)
        of_sites = tuple("tube" if len(key) == TUBE else "site" for key in self.sites)
        others = {"singular": self.singular, "control": len(self.controls), "tendon": len(self.tendons)}
        others |= {"robust": len(self.corners) * self.n_u}
        return (*named, *(kind for kind, n in others.items() for _ in range(n)), *of_sites)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Speeds:
    """What gives the rates (n_q,) of all joints and the speeds (n_u,) of actuators, written where they are asked for."""

    joints: Callable[[], ca.SX]
    actuators: Callable[[], ca.SX]


@functools.lru_cache(maxsize=16)
def mechanism_system(mechanism: Mechanism, asked: NodeTerms) -> System:
    """Return a mechanism's system.

    A node's parameters are, in this order: the weights of the running costs; the reference (n_s,), scaled, where it is
    tracked; the scales; alpha and beta of each motor's line [1 / effort, 1 / speed]; 1 / F^2 of each closure limited at
    nodes, F of each limited at every instant; 1 / det J_z at home where that is limited.
    """
    n_s, n_q, n_u = mechanism.dof, mechanism.n_q, mechanism.n_u
    works = "work" in asked.running
    borne = [list(range(rows.start, rows.stop)) for rows in map(mechanism.closure_slice, asked.bearing)]
    n_borne = sum(map(len, borne))
    node = node_symbols(n_s, 0, n_algebraic(mechanism, works=works, others=len(asked.levers) + n_borne), n_u)
    n_z, lifts = node.z.numel(), is_lifted(mechanism)
    parts = [0, n_q - n_s, n_q - n_s + n_lifted(mechanism), n_z - n_borne - len(asked.levers), n_z - n_borne, n_z]
    z, lifted, working, levers, forces = ca.vertsplit(node.z, parts)
    sizes = {"weight": len(asked.running), "reference": n_s if "tracking" in asked.running else 0}
    sizes |= {"time": 1, "position": n_s, "effort": n_u, "residual": n_s, "length": 1, "power": 1, "force": 1}
    sizes |= {
        "line": 2 * len(asked.motors),
        "rating": len(asked.closures),
        "bearing": len(asked.bearing),
        "home": asked.singular,
    }
    sizes |= {"payload": 0 if mechanism.payload is None else len(mechanism.payload.numbers())}
    given = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
    rate = given["position"] / given["time"]
    q = in_order(mechanism, node.s * given["position"], z)
    v, a, u = node.v * rate, node.a * rate / given["time"], node.u * given["effort"]
    call = _caller(mechanism, given["payload"])
    equations = call("independent_closure", q) / given["length"]
    kinds = ("closure",) * (n_q - n_s)
    if lifts:
        rows, named, rates = lifted_rows(mechanism, lifted, call, given, (q, v, a, u))
        equations, kinds = ca.vertcat(equations, rows), kinds + named
        speeds = Speeds(joints=lambda: rates, actuators=lambda: call("effort_matrix", q).T @ rates)
    else:
        equations = ca.vertcat(equations, call("residual", q, v, a, u) / given["residual"])
        kinds += ("dynamics",) * n_s
        speeds = Speeds(joints=lambda: call("velocity_map", q) @ v, actuators=lambda: call("effort_map", q).T @ v)
    if asked.levers:
        leverage = ca.diag(rate) @ call("effort_map", q) @ ca.diag(given["effort"]) / given["power"]
        equations = ca.vertcat(equations, ca.vertcat(*(leverage[s, j] for j, s in asked.levers)) - levers)
        kinds += ("leverage",) * len(asked.levers)
    if borne:
        force = call("closure_force", q, v, a, u)
        shares = [force[rows] / given["bearing"][item] for item, rows in enumerate(borne)]
        equations = ca.vertcat(equations, ca.vertcat(*shares) - forces)
        kinds += ("bearing",) * n_borne
    path = _path(mechanism, asked, given, call, (q, v, a, u), speeds)
    kinds += asked.kinds
    if works:
        spent = u * speeds.actuators() / given["power"]
        path.append(working - spent)
        kinds += ("work",) * n_u
    path = ca.vertcat(ca.SX(0, 1), *path)
    running = _running(asked, given, node, working, call, (q, v, a, u))
    theta = ca.vertcat(*given.values())
    column = ca.densify(ca.vertcat(equations, path, running))
    return System(
        n_s=n_s,
        n_x=0,
        n_z=node.z.numel(),
        n_u=n_u,
        node=ca.Function("node", [node.stacked, theta], [column]),
        n_equations=equations.numel(),
        n_path=path.numel(),
        kinds=kinds,
    )


def n_algebraic(mechanism: Mechanism, *, works: bool, others: int) -> int:
    """Return the number of algebraic unknowns: dependent joints, what is lifted, powers where work costs, levers, forces."""
    return len(mechanism.dependent) + n_lifted(mechanism) + (mechanism.n_u if works else 0) + others


def _caller(mechanism: Mechanism, payload: ca.SX) -> Callable[..., ca.SX]:
    """Return a caller of the reduced dynamics' functions by name, a payload's numbers being parameters."""
    if mechanism.payload is None:
        return lambda name, *arguments: getattr(mechanism.dynamics, name)(*arguments)
    dynamics = mechanism.parametric_dynamics()
    return lambda name, *arguments: getattr(dynamics, name)(*arguments, payload)


def _path(
    mechanism: Mechanism, asked: NodeTerms, given: dict[str, ca.SX], call: Callable[..., ca.SX], motion, speeds: Speeds
) -> list[ca.SX]:
    """Return the path quantities that limits ask for: speeds in units of 1 / time, powers in theirs, the rest as shares."""
    q, _, _, u = motion
    path = [given["time"] * speeds.joints()[joint] for joint in asked.speed_joints]
    if asked.motors or asked.powers:
        w = speeds.actuators()
        for item, j in enumerate(asked.motors):
            path.append(given["line"][2 * item] * u[j] + given["line"][2 * item + 1] * w[j])
        path += [u[j] * w[j] / given["power"] for j in asked.powers]
    if asked.closures:
        force = call("closure_force", *motion)
        for item, c in enumerate(asked.closures):
            path.append(ca.sumsqr(force[mechanism.closure_slice(c)]) * given["rating"][item])
    if asked.singular:
        path.append(call("block_singularity", q) * given["home"])
    if asked.controls:
        length, w = call("actuator_length", q), speeds.actuators()
        for j in asked.controls:
            b, gain = mechanism.actuators[j].biases, mechanism.actuators[j].gain
            ctrl = (u[j] - b[0] - b[1] * length[j] - b[2] * w[j]) / gain
            path.append(ranged_control(mechanism.actuators[j], ctrl, u[j], gain, ca.fmax) / control_unit(mechanism, j))
    lengths = call("tendon_length", q) if asked.tendons else ca.SX(0, 1)
    path += [lengths[item] / mechanism.tendons[item].span for item in asked.tendons]
    efforts = corner_efforts(mechanism, asked.corners, call, given["payload"], motion)
    path += [effort / given["effort"] for effort in efforts]
    return path + [site_row(mechanism, key, q) for key in asked.sites]


def control_unit(mechanism: Mechanism, actuator: int) -> float:
    """Return the unit of a servo's ctrl in the program: the larger end of its range."""
    ends = np.abs([mechanism.actuators[actuator].control_lower, mechanism.actuators[actuator].control_upper])
    return float(ends[np.isfinite(ends)].max(initial=0.0)) or 1.0


def _running(
    asked: NodeTerms, given: dict[str, ca.SX], node: NodeSymbols, working: ca.SX, call: Callable[..., ca.SX], motion
) -> ca.SX:
    """Return the weighted running costs, each in its own unit."""
    total = ca.SX(0)
    for item, term in enumerate(asked.running):
        if term == "tracking":
            share_of = (given["position"] / ca.mmax(given["position"])) ** 2
            value = ca.dot(share_of, (node.s - given["reference"]) ** 2)
        elif term == "work":
            value = ca.sum1(working)
        else:
            value = ca.sumsqr(call("closure_force", *motion)) / given["force"] ** 2
        total += given["weight"][item] * value
    return total


def node_numbers(
    mechanism: Mechanism, asked: NodeTerms, scales: Scales, weights, lines, largest: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of a node's parameters before and after the reference, in the order of `mechanism_system`.

    Args:
        mechanism: the mechanism, for its home pose.
        asked: the structure.
        scales: units.
        weights: of the running costs.
        lines: (alpha, beta) of each motor asked for.
        largest: force (n_closures,) [N] of each closure.
    """
    after = [scales.vector(), np.ravel(lines), 1.0 / np.square(largest[list(asked.closures)]), largest[list(asked.bearing)]]
    if asked.singular:
        after.append(1.0 / np.array(mechanism.dynamics.block_singularity(mechanism.home)).ravel())
    if mechanism.payload is not None:
        after.append(mechanism.payload.numbers())
    return np.asarray(weights, dtype=float), np.concatenate([np.asarray(part, dtype=float) for part in after])
