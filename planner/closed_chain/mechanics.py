"""A mechanism as a system for the transcription: closure and reduced dynamics at a node, all scaled.

Second-order coordinates are the independent joints. Algebraic unknowns are the dependent joints (tied by phi(s, z) = 0);
each actuator's positive power P if work is minimised (P >= u w and P >= 0 are exact and leave no kink in the program); and
the unknowns of limits that are imposed at every instant. Equations: phi(q) / length and (inverse_dynamics(q, v, a) -
Gamma^T B u) / scale. Path quantities: the limits' rows.
"""

import functools
import itertools
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.planner.closed_chain.lifted import in_order, is_lifted, lifted_rows, n_lifted
from linkplan.planner.limits.path_limit import PathLimit
from linkplan.planner.limits.site import SitePathLimit
from linkplan.planner.problem.instant import Instant
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.scales import Scales
from linkplan.planner.problem.terms import Term
from linkplan.planner.transcription.system import System, node_symbols


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeTerms:
    """The terms evaluated at a node, which determine the structure of its functions.

    `running` are the objective's terms that are integrals of a quantity at nodes. `limits` have rows or unknowns at nodes.
    `passed` are the sites' coordinates (site, axis) that waypoints prescribe.
    """

    running: tuple[Term, ...] = ()
    limits: tuple[PathLimit, ...] = ()
    passed: tuple[tuple[int, int], ...] = ()

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
        return sum(limit.n_unknowns for limit in self.limits)

    @property
    def rows(self) -> tuple[PathLimit, ...]:
        """The limits with rows at nodes."""
        return tuple(limit for limit in self.limits if limit.at_nodes)


@functools.lru_cache(maxsize=16)
def mechanism_system(mechanism: Mechanism, asked: NodeTerms) -> System:
    """Return a mechanism's system.

    A node's parameters are, in this order: weights of the running costs; the scaled reference (n_s,) if it is tracked;
    scales; numbers of the limits; numbers of the payload.
    """
    n_s, n_q, n_u = mechanism.dof, mechanism.n_q, mechanism.n_u
    node = node_symbols(n_s, 0, n_algebraic(mechanism, asked), n_u)
    n_z = node.z.numel()
    parts = [0, n_q - n_s, n_q - n_s + n_lifted(mechanism), n_z - asked.n_unknowns, n_z]
    z, lifted, working, unknowns = ca.vertsplit(node.z, parts)
    sizes = {"weight": len(asked.running), "reference": n_s if asked.tracked else 0}
    sizes |= {"time": 1, "position": n_s, "effort": n_u, "residual": n_s, "length": 1, "power": 1, "force": 1}
    sizes |= {"limits": sum(limit.n_numbers for limit in asked.limits)}
    sizes |= {"payload": 0 if mechanism.payload is None else len(mechanism.payload.numbers())}
    given = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
    rate = given["position"] / given["time"]
    q = in_order(mechanism, node.s * given["position"], z)
    v, a, u = node.v * rate, node.a * rate / given["time"], node.u * given["effort"]
    call = _caller(mechanism, given["payload"])
    equations, kinds, rates = call("independent_closure", q) / given["length"], ("closure",) * (n_q - n_s), None
    if is_lifted(mechanism):
        rows, named, rates = lifted_rows(mechanism, lifted, call, given, (q, v, a, u))
        equations, kinds = ca.vertcat(equations, rows), kinds + named
    else:
        equations = ca.vertcat(equations, call("residual", q, v, a, u) / given["residual"])
        kinds += ("dynamics",) * n_s
    at = Instant(
        mechanism=mechanism,
        q=q,
        v=v,
        a=a,
        u=u,
        payload=given["payload"],
        call=call,
        units=given,
        rates=rates,
        reference=given["reference"] * given["position"] if asked.tracked else None,
        positive_power=working * given["power"] if asked.works else None,
    )
    numbers = _split(given["limits"], [limit.n_numbers for limit in asked.limits])
    places = _split(unknowns, [limit.n_unknowns for limit in asked.limits])
    for limit, own, place in zip(asked.limits, numbers, places, strict=True):
        if limit.n_unknowns:
            kind, values = limit.unknowns(at, own)
            equations = ca.vertcat(equations, ca.vertcat(*values) - place)
            kinds += (kind,) * limit.n_unknowns
    path = _path_rows(asked, at, numbers, working)
    kinds += tuple(limit.row_kind for limit in asked.rows) + ("site",) * len(asked.passed) + ("work",) * working.numel()
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
    )


def _path_rows(asked: NodeTerms, at: Instant, numbers: list[ca.SX], working: ca.SX) -> ca.SX:
    """Return the path quantities: limits' rows, sites' coordinates at waypoints, P - u w of positive powers."""
    path = [limit.row(at, own) for limit, own in zip(asked.limits, numbers, strict=True) if limit.at_nodes]
    path += [SitePathLimit.coordinate(*where).row(at, ca.SX(0, 1)) for where in asked.passed]
    if asked.works:
        path.append(working - at.u * at.actuator_speeds / at.units["power"])
    return ca.vertcat(ca.SX(0, 1), *path)


def n_algebraic(mechanism: Mechanism, asked: NodeTerms) -> int:
    """Return the number of algebraic unknowns: dependent joints, lifted unknowns, positive powers, limits' unknowns."""
    return len(mechanism.dependent) + n_lifted(mechanism) + (mechanism.n_u if asked.works else 0) + asked.n_unknowns


def _split(column: ca.SX, sizes: list[int]) -> list[ca.SX]:
    """Return consecutive parts of a column."""
    return [column[end - size : end] for size, end in zip(sizes, itertools.accumulate(sizes), strict=True)]


def _caller(mechanism: Mechanism, payload: ca.SX) -> Callable[..., ca.SX]:
    """Return a function that calls the reduced dynamics by name, with the payload's numbers as parameters."""
    if mechanism.payload is None:
        return lambda name, *arguments: getattr(mechanism.dynamics, name)(*arguments)
    dynamics = mechanism.parametric_dynamics()
    return lambda name, *arguments: getattr(dynamics, name)(*arguments, payload)


def node_numbers(problem: Problem, asked: NodeTerms, scales: Scales, value: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of a node's parameters before and after the reference, in the order of `mechanism_system`.

    `value` is the objective's unit in SI.
    """
    of = problem.objective.terms.items()
    weights = [problem.objective.weight(name) * scales.time_s / value for name, term in of if term in asked.running]
    after = [scales.vector(), *(limit.numbers(problem) for limit in asked.limits)]
    if problem.mechanism.payload is not None:
        after.append(problem.mechanism.payload.numbers())
    return np.asarray(weights, dtype=float), np.concatenate([np.asarray(part, dtype=float) for part in after])
