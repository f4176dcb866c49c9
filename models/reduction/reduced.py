"""Reduced dynamics of a closed chain, by coordinate partitioning.

    q' = Gamma v,   Gamma = [I; -J_z^-1 J_s],   q'' = Gamma a + gamma,   gamma_z = -J_z^-1 (J' q')
    Gamma^T (M q'' + h - tau_passive) = Gamma^T B u

v = s' and a = s'' belong to the independent joints, z are the dependent joints, and J = dphi/dq has the independent rows
(Wehage & Haug, J. Mech. Design 104, 1982). The multipliers follow from the dependent rows, J_z^T lambda = (...)_z.
Overconstrained loops have no rows that are independent at every pose: there E J replaces J, see `models.closure.newton`.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import casadi as ca
import numpy as np

from linkplan.models.closure.equations import Closure, rows_by_pin
from linkplan.models.closure.newton import ProjectedLoops, combination, constant_combination, jacobians_at_random
from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.reduction.elimination import (
    block_determinants,
    block_rows,
    determinant,
    factorise,
    solve_positive,
    solved_in_numbers,
)
from linkplan.models.tree.dynamics import Tree, site_places
from linkplan.models.tree.joints import ball_turns
from linkplan.models.tree.tendons import limited_tendons

# Name of the functions' parameter input.
_PARAMETERS = "parameters"


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ReducedDynamics:
    """CasADi functions of a closed chain; each can be called with numbers or with SX.

    q (n_q,) contains all joints, v and a (n_s,) the independent joints' rates and accelerations, u (n_u,) the efforts.
    Generalised efforts (n_s,) are in [N.m] on a hinge and [N] on a slide.
    """

    independent: tuple[int, ...]  # indices of s in q
    dependent: tuple[int, ...]  # indices of z in q
    closure: ca.Function  # q -> phi (n_rows,) [m], every row
    independent_closure: ca.Function  # q -> E phi (rank,) [m], independent rows or normal equations
    closure_jacobian: ca.Function  # q -> J (n_rows, n_q)
    closure_step: ca.Function  # q -> Newton's step -J_z^-1 phi in z, Gamma, determinants of J_z's blocks
    velocity_map: ca.Function  # q -> Gamma (n_q, n_s)
    block_singularity: ca.Function  # q -> determinants of J_z's blocks, zero at a singular pose; a block has coupled loops
    orientation: ca.Function  # q_0, q -> products of block_singularity at q_0 and q: negative if a fold lies between
    projected: bool  # true if some loops are closed by normal equations, whose determinants have no sign
    mass_matrix: ca.Function  # q -> M (n_q, n_q), armature included
    bias: ca.Function  # q, q' -> h (n_q,), MuJoCo's qfrc_bias
    passive: ca.Function  # q, q' -> springs and dampers (n_q,)
    reduced_inertia: ca.Function  # q -> Gamma^T M Gamma (n_s, n_s)
    gravity_effort: ca.Function  # q -> Gamma^T g (n_s,), the effort that balances gravity
    tree_effort: ca.Function  # (q, qd, qdd) -> M q'' + h - tau_passive - friction (n_q,) of the tree with open loops
    # q, q', q'', mu, u -> E phi with its first and second derivative by time (rank,), and J_z^T mu - f_z (rank,) and
    # f_s - J_s^T mu (n_s,) of the forces f = M q'' + h - tau_passive - friction - B u, with multipliers mu (rank,)
    equations: ca.Function
    effort_matrix: ca.Function  # q -> B (n_q, n_u), each actuator's generalised effort
    actuator_length: ca.Function  # q -> MuJoCo's actuator lengths (n_u,), NaN for sites and slider-cranks
    tendon_length: ca.Function  # q -> l (n_tendons,) of the tendons with a limited length
    ball_turns: ca.Function  # q -> sin^2(alpha / 2) (n_balls,) of the ball joints with a limited angle alpha
    effort_map: ca.Function  # q -> Gamma^T B (n_s, n_u)
    inverse_dynamics: ca.Function  # q, v, a -> the required Gamma^T B u (n_s,)
    residual: ca.Function  # q, v, a, u -> inverse_dynamics - Gamma^T B u (n_s,)
    sliding: ca.Function  # q, v, a, u -> the residual without dry friction, which is constant while joints slide
    force_map: ca.Function  # q -> the matrix (n_rows, rank) from multipliers of the independent rows to closure forces
    closure_force: ca.Function  # q, v, a, u -> lambda (n_rows,) [N] of least norm; zero on redundant closures
    energy: ca.Function  # q, v -> kinetic, potential [J]
    site_places: ca.Function  # q -> p_world (3, n_sites) [m] of every site of the model

    def along_freedoms(self, _q: ca.SX, efforts: ca.SX) -> ca.SX:
        """Return efforts (n_s, k) along the freedoms, of those in all equations of motion; there may be more equations."""
        return efforts

    def driven(self, q: ca.SX, v: ca.SX, u: ca.SX, *further: ca.SX) -> ca.SX:
        """Return the effort (n_s,) along the freedoms that accelerates them, Gamma^T B u less that at zero acceleration."""
        bias = self.inverse_dynamics(q, v, ca.DM.zeros(v.numel()), *further)
        return self.along_freedoms(q, self.effort_map(q, *further) @ u - bias)

    @property
    def acceleration(self) -> ca.Function:
        """q, v, u -> a (n_s,); built at the first use."""
        return _forward(self)[0]

    @property
    def flow(self) -> ca.Function:
        """q, v, u -> q' (n_q,), v' (n_s,); built at the first use."""
        return _forward(self)[1]

    @property
    def linearisation(self) -> ca.Function:
        """q, v, u -> da/ds, da/dv, da/du along the closed chain; built at the first use."""
        return _linearisation(self)


@functools.lru_cache(maxsize=64)
def _forward(dynamics: ReducedDynamics) -> tuple[ca.Function, ca.Function]:
    """Return `acceleration` and `flow`: M_r a = Gamma^T B u - b_r, q' = Gamma v."""
    q, v, _, u, *further = _symbols(dynamics, ca.SX)
    inputs, names = [q, v, u, *further], ["i0", "i1", "i2"] + [_PARAMETERS] * len(further)
    found = [dynamics.velocity_map(q, *further) @ v, dynamics.driven(*inputs)]
    if solved_in_numbers(len(dynamics.independent)):
        terms = ca.Function("terms", inputs, [ca.densify(one) for one in ca.cse(found)])
        q, v, _, u, *further = _symbols(dynamics, ca.MX)
        inputs = [q, v, u, *further]
        found = list(terms(*inputs))
    rates, driven = found
    rates, a = (ca.densify(one) for one in ca.cse([rates, solve_positive(dynamics.reduced_inertia(q, *further), driven)]))
    return (
        ca.Function("acceleration", inputs, [a], names, ["o0"]),
        ca.Function("flow", inputs, [rates, a], names, ["o0", "o1"]),
    )


def _symbols(dynamics: ReducedDynamics, kind: type) -> list:
    """Return symbols of q, v, a, u and parameters: scalars (SX) or matrices (MX)."""
    of = dynamics.residual
    return [kind.sym(of.name_in(i), of.sparsity_in(i)) for i in range(of.n_in())]


def acceleration_at(dynamics: ReducedDynamics, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the accelerations (n_s,) at one pose, solved in numbers."""
    bias = dynamics.inverse_dynamics(q, v, np.zeros(len(v))).full().ravel()
    return np.linalg.solve(dynamics.reduced_inertia(q).full(), dynamics.effort_map(q).full() @ u - bias)


@functools.lru_cache(maxsize=64)
def _linearisation(dynamics: ReducedDynamics) -> ca.Function:
    """Return the linearisation by the implicit function theorem: M_r da = -(dr/dq Gamma ds + dr/dv dv) + Gamma^T B du.

    r is the residual without dry friction. Near rest, smoothed dry friction would add damping that no machine has.
    """
    scalars = _symbols(dynamics, ca.SX)
    slopes = ca.Function("slopes", scalars, [ca.jacobian(dynamics.sliding(*scalars), ca.vertcat(*scalars[:2]))])
    q, v, _, u, *further = _symbols(dynamics, ca.MX if solved_in_numbers(len(dynamics.independent)) else ca.SX)
    by = slopes(q, v, dynamics.acceleration(q, v, u, *further), u, *further)
    by_q, by_v = by[:, : q.numel()], by[:, q.numel() :]
    right = ca.horzcat(-by_q @ dynamics.velocity_map(q, *further), -by_v, dynamics.effort_map(q, *further))
    n_s = v.numel()
    found = solve_positive(dynamics.reduced_inertia(q, *further), dynamics.along_freedoms(q, right))
    outputs = [ca.densify(found[:, columns]) for columns in (slice(n_s), slice(n_s, 2 * n_s), slice(2 * n_s, None))]
    return ca.Function("linearisation", [q, v, u, *further], outputs)


def linearised(dynamics: ReducedDynamics, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return da/ds, da/dv (n_s, n_s) and da/du (n_s, n_u) at one pose, in a third of the time of `linearisation`.

    Constants replace symbols before the differentiation, and the linear system is solved numerically.
    """
    a = ca.DM(acceleration_at(dynamics, q, v, u))
    x, w = ca.SX.sym("q", len(q)), ca.SX.sym("v", len(v))
    by_q = ca.Function("by_q", [x], [ca.jacobian(dynamics.residual(x, ca.DM(v), a, ca.DM(u)), x)])(q)
    by_v = ca.Function("by_v", [w], [ca.jacobian(dynamics.residual(ca.DM(q), w, a, ca.DM(u)), w)])(v)
    gamma, inertia, effort = (f(q).full() for f in (dynamics.velocity_map, dynamics.reduced_inertia, dynamics.effort_map))
    parts = -ca.DM(by_q).full() @ gamma, -ca.DM(by_v).full(), effort
    return tuple(np.linalg.solve(inertia, part) for part in parts)


def reduce_tree(
    tree: Tree,
    closures: Sequence[Closure],
    effort_matrix: ca.SX,
    rows: np.ndarray,
    independent: np.ndarray,
    dependent: np.ndarray,
    parameters: ca.SX | None = None,
    values: np.ndarray | None = None,
    projected: Sequence[ProjectedLoops] = (),
    lengths: ca.SX | None = None,
) -> ReducedDynamics:
    """Return the reduced dynamics of `tree` under its closures, whose equations phi (n_rows,) have independent `rows`.

    `effort_matrix` is B (n_q, n_u), an expression of the tree's q. If the tree has `parameters`, they are the last input of
    every function, and `values` are those of its model. `projected` loops are closed by the normal equations of all their
    rows.
    """
    further = [] if parameters is None else [parameters]
    q, qd, qdd = tree.q, tree.qd, tree.qdd
    n_s, n_u = len(independent), effort_matrix.shape[1]
    v, a, u = ca.SX.sym("v", n_s), ca.SX.sym("a", n_s), ca.SX.sym("u", n_u)
    before = ca.SX.sym("q_0", q.numel())
    loops = _partition(tree, closures, rows, independent, dependent, projected, further)
    phi, gamma_map = loops.phi, loops.velocity_map
    dets, signs = _determinants(loops, q, before, projected)
    rates = gamma_map @ v
    gamma = ca.SX.zeros(q.numel())
    if loops.rows:
        gamma[loops.dependent] = -loops.solve(loops.convective(q, rates, *further))
    mu = ca.SX.sym("mu", len(loops.rows))
    free, bound = [int(i) for i in independent], loops.dependent

    without = tree.inverse_dynamics - tree.passive
    tree_effort = ca.Function("tree_effort", [q, qd, qdd, *further], [without - tree.friction])
    sliding_effort = ca.Function("sliding_effort", [q, qd, qdd, *further], [without])
    needed = tree_effort(q, rates, gamma_map @ a + gamma, *further)
    sliding = gamma_map.T @ sliding_effort(q, rates, gamma_map @ a + gamma, *further)
    B = effort_matrix
    inverse = gamma_map.T @ needed
    effort_map = gamma_map.T @ B
    inertia = gamma_map.T @ tree.mass_matrix @ gamma_map
    nominal = loops.jacobian
    if parameters is not None:
        nominal = ca.substitute(nominal, parameters, ca.DM(np.asarray(values)))
    force_map = _force_map(tree, closures, loops, projected, nominal)
    multipliers = factorise(loops.J_z.T)((needed - B @ u)[bound])
    held = loops.independent_jacobian.T @ mu
    forces = without - tree.friction - B @ u
    closing = loops.independent_phi, loops.independent_jacobian @ qd, loops.independent_jacobian @ qdd + loops.turning
    force = force_map @ multipliers if loops.rows else ca.SX.zeros(loops.phi.numel())
    limited_lengths = [tree.tendon_lengths[tendon.index] for tendon in limited_tendons(tree.model)]
    limited = ca.vertcat(ca.SX(0, 1), *[length for length in limited_lengths if length is not None])  # none wraps
    kinetic_at = ca.Function("kinetic", [q, qd, *further], [tree.kinetic_energy])

    def function(name: str, inputs: list[ca.SX], *outputs: ca.SX) -> ca.Function:
        names = [f"i{k}" for k in range(len(inputs))] + [_PARAMETERS] * len(further)
        results = [f"o{k}" for k in range(len(outputs))]
        return ca.Function(name, inputs + further, [ca.densify(output) for output in outputs], names, results)

    return ReducedDynamics(
        independent=tuple(int(i) for i in independent),
        dependent=tuple(bound),
        closure=function("closure", [q], phi),
        independent_closure=function("independent_closure", [q], loops.independent_phi),
        closure_jacobian=function("closure_jacobian", [q], loops.jacobian),
        closure_step=function("closure_step", [q], -loops.solve(loops.independent_phi), gamma_map, dets),
        velocity_map=function("velocity_map", [q], gamma_map),
        block_singularity=function("block_singularity", [q], dets),
        orientation=function("orientation", [before, q], signs),
        projected=bool(projected),
        mass_matrix=function("mass_matrix", [q], tree.mass_matrix),
        bias=function("bias", [q, qd], tree.bias),
        passive=function("passive", [q, qd], tree.passive),
        reduced_inertia=function("reduced_inertia", [q], inertia),
        gravity_effort=function("gravity_effort", [q], gamma_map.T @ tree.gravity),
        tree_effort=function("tree_effort", [q, qd, qdd], without - tree.friction),
        equations=function("equations", [q, qd, qdd, mu, u], *closing, (held - forces)[bound, :], (forces - held)[free, :]),
        effort_matrix=function("effort_matrix", [q], B),
        actuator_length=function("actuator_length", [q], ca.SX(n_u, 1) if lengths is None else lengths),
        tendon_length=function("tendon_length", [q], limited),
        ball_turns=function("ball_turns", [q], ball_turns(tree.model, tree.coordinates, q)),
        effort_map=function("effort_map", [q], effort_map),
        inverse_dynamics=function("inverse_dynamics", [q, v, a], inverse),
        residual=function("residual", [q, v, a, u], inverse - effort_map @ u),
        sliding=function("sliding", [q, v, a, u], sliding - effort_map @ u),
        force_map=function("force_map", [q], force_map),
        closure_force=function("closure_force", [q, v, a, u], force),
        energy=function("energy", [q, v], kinetic_at(q, rates, *further), tree.potential_energy),
        site_places=function("site_places", [q], site_places(tree)),
    )


def with_numbers(dynamics: ReducedDynamics, numbers: np.ndarray) -> ReducedDynamics:
    """Return dynamics with numbers (k,) in place of the first of their parameters; further ones stay parameters."""

    def given(function: ca.Function) -> ca.Function:
        last = function.n_in() - 1
        if function.name_in(last) != _PARAMETERS:
            return function
        inputs = [ca.SX.sym(function.name_in(i), function.sparsity_in(i)) for i in range(last)]
        names, left = [f"i{k}" for k in range(last)], ca.SX.sym(_PARAMETERS, function.numel_in(last) - len(numbers))
        outputs = function.call([*inputs, ca.vertcat(ca.DM(numbers), left)])
        if left.numel():
            inputs, names = [*inputs, left], [*names, _PARAMETERS]
        return ca.Function(function.name(), inputs, outputs, names, [f"o{k}" for k in range(len(outputs))])

    functions = {field.name: getattr(dynamics, field.name) for field in fields(ReducedDynamics)}
    return replace(dynamics, **{k: given(f) for k, f in functions.items() if isinstance(f, ca.Function)})


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Partition:
    """Expressions of coordinate partitioning over the tree's q."""

    rows: list[int]  # independent rows of phi
    dependent: list[int]
    phi: ca.SX  # (n_rows,) every row [m]
    jacobian: ca.SX  # dphi/dq (n_rows, n_q)
    combination: ca.SX | None  # E (rank, n_rows), None without overconstrained loops
    independent_phi: ca.SX  # E phi, or the independent rows of phi (rank,)
    independent_jacobian: ca.SX  # E J (rank, n_q)
    J_z: ca.SX  # (rank, rank)
    solve: Callable[[ca.SX], ca.SX]  # b -> J_z^-1 b
    velocity_map: ca.SX  # Gamma (n_q, n_s)
    turning: ca.SX  # J' q' (rank,), of the tree's q and q'
    convective: ca.Function  # q, q', parameters -> J' q' (rank,)


def _partition(
    tree: Tree,
    closures: Sequence[Closure],
    rows: np.ndarray,
    independent: np.ndarray,
    dependent: np.ndarray,
    projected: Sequence[ProjectedLoops],
    further: list[ca.SX],
) -> _Partition:
    """Return the kinematics of coordinate partitioning; `further` are the tree's parameters."""
    chosen, free, bound = ([int(i) for i in indices] for indices in (rows, independent, dependent))
    q, qd = tree.q, tree.qd
    phi = ca.vertcat(ca.SX(0, 1), *[closure.residual for closure in closures])
    jacobian = ca.jacobian(phi, q)
    E = combination(jacobian[:, bound], chosen, projected) if projected else None
    J, independent_phi = (jacobian[chosen, :], phi[chosen]) if E is None else (E @ jacobian, E @ phi)
    inexact = any(loop.inexact for loop in projected)
    if inexact:
        J = ca.jacobian(independent_phi, q)
    J_z = J[:, bound]
    solve = factorise(J_z)
    gamma_map = ca.SX.zeros(q.numel(), len(free))
    gamma_map[free, :] = ca.SX.eye(len(free))
    if chosen:
        gamma_map[bound, :] = -solve(J[:, free])
    convective = ca.jtimes(J @ qd, q, qd) if E is None or inexact else E @ ca.jtimes(jacobian @ qd, q, qd)
    return _Partition(
        rows=chosen,
        dependent=bound,
        phi=phi,
        jacobian=jacobian,
        combination=E,
        independent_phi=independent_phi,
        independent_jacobian=J,
        J_z=J_z,
        solve=solve,
        velocity_map=gamma_map,
        turning=convective,
        convective=ca.Function("convective", [q, qd, *further], [convective]),
    )


def _determinants(loops: _Partition, q: ca.SX, before: ca.SX, projected: Sequence[ProjectedLoops]) -> tuple[ca.SX, ca.SX]:
    """Return the determinants of J_z's blocks, and their products with those at the pose `before` (`orientation`).

    The block of a projected loop has the determinant sqrt(det J_z^T J_z), and the orientation det(J_z(q_0)^T J_z(q)).
    """
    dets = block_determinants(loops.J_z)
    own, signed = ca.vertsplit(dets), ca.vertsplit(dets * ca.substitute(dets, q, before))
    J_z = loops.jacobian[:, loops.dependent]
    for block, rows in enumerate(block_rows(loops.J_z)):
        of = {loops.rows[row] for row in rows}
        for loop in projected:
            if of <= set(loop.rows):
                own[block] = ca.sqrt(ca.fmax(own[block], 1e-40))  # the derivative stays finite at zero
                here = J_z[list(loop.rows), list(loop.columns)]
                signed[block] = determinant(ca.mtimes(ca.substitute(here, q, before).T, here))
    return ca.vertcat(*own), ca.vertcat(*signed)


def _force_map(
    tree: Tree, closures: Sequence[Closure], loops: _Partition, projected: Sequence[ProjectedLoops], nominal: ca.SX
) -> ca.SX:
    """Return the matrix (n_rows, rank) from multipliers J_z^-T (...)_z to the closure forces [N] of least norm.

    `nominal` is the closures' Jacobian at the values of the parameters, which do not change the plane of a planar loop.
    """
    n_rows, rank = loops.phi.numel(), len(loops.rows)
    if not rank:
        return ca.SX(n_rows, 0)
    if loops.combination is None:
        given = ca.SX(n_rows, rank)
        given[loops.rows, :] = ca.SX.eye(rank)
    else:
        given = loops.combination.T
    whole = {row for loop in projected for row in loop.rows}  # their forces have least norm already
    kept = [row for row in range(n_rows) if row in whole or row in loops.rows]
    jacobian = ca.Function("J", [tree.q], [ca.densify(nominal)])
    return _least_norm(jacobian, kept, rows_by_pin(tree.model, closures)) @ given


def _least_norm(jacobian: ca.Function, chosen: list[int], gaps: list[list[int]]) -> ca.DM:
    """Return the matrix (n_rows, n_rows) that maps forces on the chosen rows to equivalent forces of least norm on all rows.

    In a planar loop one of a connect's three rows depends on the other two, J_c = C J_chosen with a constant C. Then
    C (C^T C)^-1 mu has the size of the pin force, whichever rows were chosen. If C is not constant (spatial loops, rows that
    depend on another closure's rows), the forces stay on the chosen rows.
    """
    n_rows = jacobian.size1_out(0)
    spread = np.eye(n_rows)
    samples = jacobians_at_random(jacobian)
    for of in gaps:
        kept = [row for row in of if row in chosen]
        if not kept or len(kept) == len(of):
            continue
        C = constant_combination(samples, of, kept, ROUNDING_SHARE)
        if C is None:
            continue
        block = np.zeros((len(of), n_rows))
        block[:, kept] = np.linalg.pinv(C).T  # C (C^T C)^-1, also where chosen rows depend on one another
        spread[of] = np.where(np.abs(block) > 1e-12, block, 0.0)
    return ca.sparsify(ca.DM(spread))
