"""A mechanism as a system for the transcription: closure and reduced dynamics at a node, all scaled.

Second-order coordinates are the independent joints. Algebraic unknowns are the dependent joints (tied by phi(s, z) = 0);
each actuator's positive power P if work is minimised (P >= u w and P >= 0 are exact and leave no kink in the program); and
the unknowns of limits that are imposed at every instant. Equations: phi(q) / length and (inverse_dynamics(q, v, a) -
Gamma^T B u) / scale. Path quantities: the limits' rows.

Reduced dynamics solve symbolically with J_z, the closure's derivative by the dependent joints. If the loops cannot be closed
one after another, as under a platform on six legs, J_z is one block: with 15 joints a node's second derivatives have 3.4
million operations. In lifted form (Albersmeyer & Diehl, SIAM J. Optim. 20, 2010), rates, accelerations and multipliers of
dependent joints are unknowns, and the same equations are

    phi(q) = 0,   J q' = 0,   J q'' + J' q' = 0,   M q'' + h - B u - J^T mu = 0.

Nothing is solved symbolically. There are 3 n_z more unknowns and rows, but the expressions are as short as those of the
tree. The motions are the same.
"""

import functools
import itertools
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.planner.limits.body import coordinate
from linkplan.planner.limits.limit import Limit, LimitFacts
from linkplan.planner.problem.instant import Instant, Scales, with_parameters
from linkplan.planner.problem.objective import Term
from linkplan.planner.problem.problem import Problem
from linkplan.planner.transcription.system import System, node_symbols

# Operations of Gamma (the solution with J_z) above which a program is lifted. Andrews' squeezer has 322 and is not.
# Processor time [s] of a least time without and with lifting, at equal objectives: a delta robot (2,002 operations) 8 and 9,
# without a compiler 27 and 9; a Stewart platform (6,859) 30 and 34; a platform on six rods (14,931) 172 and 58.
_MAX_ELIMINATION_OPERATIONS = 1_000


@functools.lru_cache(maxsize=16)
def is_lifted(mechanism: Mechanism) -> bool:
    """Check if a mechanism's program is lifted; an open tree has no dependent joints to lift.

    Along a path it is not lifted, because lifted multipliers would be forces of the path.
    """
    if not len(mechanism.dependent) or mechanism.dynamics.projected or mechanism.n_equations > mechanism.dof:
        return False
    return mechanism.dynamics.velocity_map.n_instructions() > _MAX_ELIMINATION_OPERATIONS


def n_lifted(mechanism: Mechanism) -> int:
    """Return the number of lifted unknowns: rates and accelerations of dependent joints, and multipliers."""
    return 3 * len(mechanism.dependent) if is_lifted(mechanism) else 0


def in_order(mechanism: Mechanism, independent: ca.SX, dependent: ca.SX) -> ca.SX:
    """Return the values of all joints (n_q,) from those of the independent and the dependent joints."""
    order = np.argsort(np.concatenate([mechanism.independent, mechanism.dependent]))
    return ca.vertcat(independent, dependent)[[int(i) for i in order]]


def lifted_rows(
    mechanism: Mechanism, unknowns: ca.SX, call, given: dict[str, ca.SX], motion: tuple[ca.SX, ca.SX, ca.SX, ca.SX]
) -> tuple[ca.SX, tuple[str, ...], ca.SX]:
    """Return a node's rows other than phi, their kinds, and the rates (n_q,) of all joints.

    Args:
        mechanism: the mechanism.
        unknowns: (3 n_z,) rates and accelerations of dependent joints and multipliers, scaled.
        call: the reduced dynamics' functions by name.
        given: the node's parameters.
        motion: q (n_q,), v, a (n_s,) and u (n_u,) in SI.
    """
    q, v, a, u = motion
    rates, accelerations, multipliers = ca.vertsplit(unknowns, len(mechanism.dependent))
    rates = in_order(mechanism, v, rates / given["time"])
    accelerations = in_order(mechanism, a, accelerations / given["time"] ** 2)
    opening, turning, held = _closure(mechanism)(q, rates, accelerations, multipliers * given["force"])
    left = call("tree_effort", q, rates, accelerations) - call("effort_matrix", q) @ u - held
    unit = ca.mmax(given["residual"])
    slides = np.array([mechanism.joints[int(i)].kind == "slide" for i in mechanism.dependent])
    units = ca.vertcat(*[unit / given["length"] if slide else unit for slide in slides])
    units = in_order(mechanism, ca.vertcat(*[unit] * len(mechanism.independent)), units)
    opening, turning = opening * given["time"] / given["length"], turning * given["time"] ** 2 / given["length"]
    kinds = ("closure",) * opening.numel() + ("acceleration",) * turning.numel() + ("dynamics",) * left.numel()
    return ca.vertcat(opening, turning, left / units), kinds, rates


@functools.lru_cache(maxsize=16)
def _closure(mechanism: Mechanism) -> ca.Function:
    """Return (q, q', q'', mu) -> J q', J q'' + J' q' and J^T mu, of the independent closure equations."""
    q, rates, accelerations = (ca.SX.sym(name, mechanism.n_q) for name in ("q", "qd", "qdd"))
    phi = mechanism.dynamics.independent_closure(q)
    mu = ca.SX.sym("mu", phi.numel())
    opening = ca.jtimes(phi, q, rates)
    turning = ca.jtimes(phi, q, accelerations) + ca.jtimes(opening, q, rates)
    outputs = [ca.densify(part) for part in (opening, turning, ca.jtimes(phi, q, mu, True))]
    return ca.Function("closure", [q, rates, accelerations, mu], outputs)


def lifted_start(
    mechanism: Mechanism,
    poses: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    effort: np.ndarray,
    time_s: float,
    force: float,
    *forces: np.ndarray,
) -> np.ndarray:
    """Return the scaled unknowns (n, 3 n_z) along poses (n, n_q) with v, a (n, n_s) and efforts (n, n_u).

    `forces` are those of `Mechanism.forces_at`.
    """
    dynamics, dependent, found = mechanism.dynamics, mechanism.dependent, []
    rows = dynamics.independent_closure.numel_out(0)
    for pose, speed, acceleration, u, *w in zip(poses, v, a, effort, *forces, strict=True):
        gamma = np.array(dynamics.velocity_map(pose))
        rates, still = gamma @ speed, gamma @ acceleration
        turning = np.array(_closure(mechanism)(pose, rates, still, np.zeros(rows))[1]).ravel()
        J = _jacobian(mechanism)(pose).full()
        still[dependent] -= np.linalg.lstsq(J[:, dependent], turning, rcond=None)[0]
        needed = mechanism.forced.tree_effort(pose, rates, still, *w)
        left = np.array(needed - dynamics.effort_matrix(pose) @ u).ravel()
        mu = np.linalg.lstsq(J[:, dependent].T, left[dependent], rcond=None)[0]
        found.append(np.concatenate([rates[dependent] * time_s, still[dependent] * time_s**2, mu / force]))
    return np.array(found)


@functools.lru_cache(maxsize=16)
def _jacobian(mechanism: Mechanism) -> ca.Function:
    q = ca.SX.sym("q", mechanism.n_q)
    return ca.Function("jacobian", [q], [ca.densify(ca.jacobian(mechanism.dynamics.independent_closure(q), q))])


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeTerms:
    """The terms evaluated at a node, which determine the structure of its functions.

    `running` are the objective's terms that are integrals of a quantity at nodes. `limits` have rows or unknowns at nodes.
    `passed` are the coordinates (index, axis) of sites and bodies that waypoints prescribe. `has_jerk` is True if any of
    these depends on the independent joints' jerk.
    """

    running: tuple[Term, ...] = ()
    limits: tuple[Limit, ...] = ()
    passed: tuple[tuple[int, int], ...] = ()
    has_jerk: bool = False

    @property
    def tracked(self) -> bool:
        """Whether a running cost needs the reference."""
        return any("reference" in term.needs for term in self.running)

    @property
    def works(self) -> bool:
        """Whether the actuators' positive powers are unknowns."""
        return any(term.positive_power for term in self.running)

    @property
    def n_unknowns(self) -> int:
        """The number of algebraic unknowns of the limits."""
        return sum(limit.rows.n_unknowns for limit in self.limits)

    @property
    def rows(self) -> tuple[Limit, ...]:
        """The limits with rows at nodes."""
        return tuple(limit for limit in self.limits if limit.rows.node is not None)


@functools.lru_cache(maxsize=16)
def mechanism_system(mechanism: Mechanism, asked: NodeTerms) -> System:
    """Return a mechanism's system.

    A node's parameters are, in this order: weights of the running costs; the scaled reference (n_s,) if it is tracked;
    scales; numbers of the limits; numbers of the payload; forces over time.
    """
    n_s, n_q, n_u = mechanism.dof, mechanism.n_q, mechanism.n_u
    node = node_symbols(n_s, 0, n_algebraic(mechanism, asked), n_u, has_jerk=asked.has_jerk)
    n_z = node.z.numel()
    parts = [0, n_q - n_s, n_q - n_s + n_lifted(mechanism), n_z - asked.n_unknowns, n_z]
    z, lifted, working, unknowns = ca.vertsplit(node.z, parts)
    sizes = {"weight": len(asked.running), "reference": n_s if asked.tracked else 0}
    sizes |= {
        "time": 1,
        "position": n_s,
        "effort": n_u,
        "residual": mechanism.n_equations,
        "length": 1,
        "power": 1,
        "force": 1,
    }
    sizes |= {"limits": sum(limit.rows.n_numbers for limit in asked.limits)}
    sizes |= {"payload": 0 if mechanism.payload is None else len(mechanism.payload.numbers())}
    sizes |= {"forces": 0 if mechanism.forces is None else 3 * len(mechanism.forces.sites)}
    given = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
    rate = given["position"] / given["time"]
    q = in_order(mechanism, node.s * given["position"], z)
    v, a, u = node.v * rate, node.a * rate / given["time"], node.u * given["effort"]
    call = _caller(mechanism, given["payload"], given["forces"])
    equations, kinds, rates = call("independent_closure", q) / given["length"], ("closure",) * (n_q - n_s), None
    if is_lifted(mechanism):
        rows, named, rates = lifted_rows(mechanism, lifted, call, given, (q, v, a, u))
        equations, kinds = ca.vertcat(equations, rows), kinds + named
    else:
        left = call("residual", q, v, a, u) / given["residual"]
        equations, kinds = ca.vertcat(equations, left), kinds + ("dynamics",) * left.numel()
    at = Instant(
        mechanism=mechanism,
        q=q,
        v=v,
        a=a,
        u=u,
        payload=given["payload"],
        forces=given["forces"],
        call=call,
        units=given,
        rates=rates,
        reference=given["reference"] * given["position"] if asked.tracked else None,
        jerk=node.j * rate / given["time"] ** 2 if asked.has_jerk else None,
        positive_power=working * given["power"] if asked.works else None,
    )
    numbers = _split(given["limits"], [limit.rows.n_numbers for limit in asked.limits])
    places = _split(unknowns, [limit.rows.n_unknowns for limit in asked.limits])
    for limit, own, place in zip(asked.limits, numbers, places, strict=True):
        if limit.rows.unknowns is not None:
            kind, values = limit.rows.unknowns(at, own)
            equations = ca.vertcat(equations, ca.vertcat(*values) - place)
            kinds += (kind,) * limit.rows.n_unknowns
    path = _path_rows(asked, at, numbers, working)
    kinds += (
        tuple(_row_kind(limit.facts) for limit in asked.rows) + ("path",) * len(asked.passed) + ("work",) * working.numel()
    )
    # Weights apply to integrands in SI and include the conversion of units.
    running = sum((given["weight"][item] * term.integrand(at) for item, term in enumerate(asked.running)), start=ca.SX(0))
    theta = ca.vertcat(*given.values())
    column = ca.densify(ca.vertcat(equations, path, running))
    return System(
        n_s=n_s,
        n_x=0,
        n_z=n_z,
        n_u=n_u,
        node=ca.Function("node", [node.stacked, theta], [column]),
        n_equations=equations.numel(),
        n_path=path.numel(),
        kinds=kinds,
        has_jerk=asked.has_jerk,
    )


def _row_kind(facts: LimitFacts) -> str:
    second = facts.of_position if facts.second_order is None else facts.second_order
    return "path" if second else facts.kind


def _path_rows(asked: NodeTerms, at: Instant, numbers: list[ca.SX], working: ca.SX) -> ca.SX:
    """Return the path quantities: the limits' rows, coordinates at waypoints, and P - u w for each positive power P."""
    rows = [(limit.rows.node, own) for limit, own in zip(asked.limits, numbers, strict=True)]
    path = [node(at, own) for node, own in rows if node is not None]
    path += [coordinate(at, *where) for where in asked.passed]
    if asked.works:
        path.append(working - at.u * at.actuator_speeds / at.units["power"])
    return ca.vertcat(ca.SX(0, 1), *path)


def n_algebraic(mechanism: Mechanism, asked: NodeTerms) -> int:
    """Return the number of algebraic unknowns: dependent joints, lifted unknowns, positive powers, limits' unknowns."""
    return len(mechanism.dependent) + n_lifted(mechanism) + (mechanism.n_u if asked.works else 0) + asked.n_unknowns


def _split(column: ca.SX, sizes: list[int]) -> list[ca.SX]:
    """Return consecutive parts of a column."""
    return [column[end - size : end] for size, end in zip(sizes, itertools.accumulate(sizes), strict=True)]


def _caller(mechanism: Mechanism, payload: ca.SX, forces: ca.SX) -> Callable[..., ca.SX]:
    """Return a function that calls the reduced dynamics by name, with the payload's numbers and forces as parameters."""
    if mechanism.payload is None and mechanism.forces is None:
        return lambda name, *arguments: getattr(mechanism.dynamics, name)(*arguments)
    return with_parameters(mechanism.parametric_dynamics(), ca.vertcat(payload, forces))


def node_numbers(problem: Problem, asked: NodeTerms, scales: Scales, value: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of a node's parameters before and after the reference, in the order of `mechanism_system`.

    The forces over time come after them.

    `value` is the objective's unit in SI.
    """
    of = problem.objective.terms.items()
    weights = [problem.objective.weight(name) * scales.time_s / value for name, term in of if term in asked.running]
    after = [scales.vector(), *(limit.rows.numbers(problem) for limit in asked.limits)]
    if problem.mechanism.payload is not None:
        after.append(problem.mechanism.payload.numbers())
    return np.asarray(weights, dtype=float), np.concatenate([np.asarray(part, dtype=float) for part in after])
