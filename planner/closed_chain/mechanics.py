"""A mechanism as a system for the transcription: closure and reduced dynamics at a node, all scaled.

Second-order coordinates are the independent joints. Algebraic unknowns are the dependent joints (tied by phi(s, z) = 0);
each actuator's positive power P if work is minimised (P >= u w and P >= 0 are exact and leave no kink in the program); and
the unknowns of limits that are imposed at every instant. Path quantities are the limits' rows.

The equations of motion are written with the rates, accelerations and multipliers of the dependent joints,

    phi(q) = 0,   J q' = 0,   J q'' + J' q' = 0,   M q'' + h - B u - J^T mu = 0,

whose expressions are as short as those of the tree with open loops. The node's functions eliminate these unknowns (see
`planner.transcription.implicit`), so that the program has the unknowns and rows of the reduced dynamics. With an inverse of
J_z in its expressions, a node's second derivatives would have 1.7 times as many operations for a four-bar, and 8 times as
many for a platform on six legs.
"""

import functools
import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.planner.limits.limit import Limit, LimitFacts
from linkplan.planner.limits.site import coordinate
from linkplan.planner.problem.instant import Instant, Scales, with_parameters
from linkplan.planner.problem.objective import Term
from linkplan.planner.problem.problem import Problem
from linkplan.planner.transcription.system import System, node_symbols


def in_order(mechanism: Mechanism, independent: ca.SX, dependent: ca.SX) -> ca.SX:
    """Return the values of all joints (n_q,) from those of the independent and the dependent joints."""
    order = np.argsort(np.concatenate([mechanism.independent, mechanism.dependent]))
    return ca.vertcat(independent, dependent)[[int(i) for i in order]]


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
def closure_jerk(mechanism: Mechanism) -> ca.Function:
    """Return the function from q and its first three time derivatives, each (n_q,), to the third derivative of E phi."""
    q, rates, accelerations, jerks = (ca.SX.sym(name, mechanism.n_q) for name in ("q", "qd", "qdd", "qddd"))
    equations = mechanism.dynamics.equations
    still = [ca.SX.zeros(equations.numel_in(k)) for k in (3, 4)]
    second = equations(q, rates, accelerations, *still)[2]
    third = ca.jtimes(second, ca.vertcat(q, rates, accelerations), ca.vertcat(rates, accelerations, jerks))
    return ca.Function("closure_jerk", [q, rates, accelerations, jerks], [ca.densify(third)])


@functools.lru_cache(maxsize=16)
def mechanism_system(mechanism: Mechanism, asked: NodeTerms) -> System:
    """Return a mechanism's system.

    A node's parameters are, in this order: weights of the running costs; the scaled reference (n_s,) if it is tracked;
    scales; numbers of the limits; the mechanism's parameters; forces over time.
    """
    n_s, n_q, n_u = mechanism.dof, mechanism.n_q, mechanism.n_u
    node = node_symbols(n_s, 0, n_algebraic(mechanism, asked), n_u, has_jerk=asked.has_jerk)
    n_z = node.z.numel()
    z, working, unknowns = ca.vertsplit(node.z, [0, n_q - n_s, n_z - asked.n_unknowns, n_z])
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
    sizes |= {"parameters": len(mechanism.parameters)}
    sizes |= {"forces": 0 if mechanism.forces is None else 3 * len(mechanism.forces.sites)}
    given = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
    rate = given["position"] / given["time"]
    q = in_order(mechanism, node.s * given["position"], z)
    v, a, u = node.v * rate, node.a * rate / given["time"], node.u * given["effort"]
    call = _caller(mechanism, given["parameters"], given["forces"])
    # Rates and accelerations of dependent joints, multipliers, and jerks of dependent joints, in SI.
    n_d, n_mu = n_q - n_s, mechanism.dynamics.equations.numel_in(3)
    blocks = (n_d, n_d, n_mu, n_d if asked.has_jerk else 0)
    y = [ca.SX.sym(f"y{k}", size) for k, size in enumerate(blocks)]
    rates, accelerations, mu = in_order(mechanism, v, y[0]), in_order(mechanism, a, y[1]), y[2]
    phi, *determining, left = call("equations", q, rates, accelerations, mu, u)
    jerk = jerks = None
    if asked.has_jerk:
        jerk = node.j * rate / given["time"] ** 2
        jerks = in_order(mechanism, jerk, y[3])
        determining.append(closure_jerk(mechanism)(q, rates, accelerations, jerks))
    equations = ca.vertcat(phi / given["length"], left / given["residual"])
    kinds = ("closure",) * (n_q - n_s) + ("dynamics",) * left.numel()
    at = Instant(
        mechanism=mechanism,
        q=q,
        v=v,
        a=a,
        u=u,
        parameters=given["parameters"],
        forces=given["forces"],
        call=call,
        units=given,
        rates=rates,
        accelerations=accelerations,
        multipliers=mu if n_mu == n_d else None,  # along a path, mu are those of the mechanism without its guide
        reference=given["reference"] * given["position"] if asked.tracked else None,
        jerk=jerk,
        jerks=jerks,
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
    column = ca.densify(ca.vertcat(equations, path, running, *determining))
    return System(
        n_s=n_s,
        n_x=0,
        n_z=n_z,
        n_u=n_u,
        node=ca.Function("node", [ca.vertcat(node.stacked, *y), theta], [column]),
        n_equations=equations.numel(),
        n_path=path.numel(),
        kinds=kinds,
        has_jerk=asked.has_jerk,
        eliminated=blocks,
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
    """Return the number of algebraic unknowns: dependent joints, positive powers, limits' unknowns."""
    return len(mechanism.dependent) + (mechanism.n_u if asked.works else 0) + asked.n_unknowns


def _split(column: ca.SX, sizes: list[int]) -> list[ca.SX]:
    """Return consecutive parts of a column."""
    return [column[end - size : end] for size, end in zip(sizes, itertools.accumulate(sizes), strict=True)]


def _caller(mechanism: Mechanism, parameters: ca.SX, forces: ca.SX) -> Callable[..., Any]:
    """Return a function that calls the reduced dynamics by name, with their parameters and forces as last input."""
    if not mechanism.parameters and mechanism.forces is None:
        return lambda name, *arguments: getattr(mechanism.dynamics, name)(*arguments)
    return with_parameters(mechanism.parametric_dynamics(), ca.vertcat(parameters, forces))


def node_numbers(problem: Problem, asked: NodeTerms, scales: Scales, value: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of a node's parameters before and after the reference, in the order of `mechanism_system`.

    The forces over time come after them.

    `value` is the objective's unit in SI.
    """
    of = problem.objective.terms.items()
    weights = [problem.objective.weight(name) * scales.time_s / value for name, term in of if term in asked.running]
    after = [scales.vector(), *(limit.rows.numbers(problem) for limit in asked.limits), problem.mechanism.parameter_values]
    return np.asarray(weights, dtype=float), np.concatenate([np.asarray(part, dtype=float) for part in after])
