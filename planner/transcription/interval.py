"""One interval of a transcription: its nodes and own rows as functions of its unknowns, with derivatives by the chain rule.

The scaled unknowns of an interval are w = [left state (s, v, x); nodal accelerations, nodal rates, nodal algebraic unknowns;
Bernstein coefficients of the effort; right state; duration of its segment]. Its width is h = share * duration. The nodes'
unknowns xi_i are polynomials in w, linear except for h. The expensive functions (the system at a node) are therefore
differentiated once, for one node, and the interval's derivatives follow by matrix products:

    J = [J_own; J_i T_i],   H = H_own + sum_i T_i^T H_i T_i + sum_k g_ik d2 xi_ik / dw2,   T_i = d xi_i / dw.

An open end is an end of the interval without a node (Radau's left end). If a path quantity may jump with the effort, its row
and the closure are imposed at open ends too, without dynamics and costs.
"""

import functools
import operator
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.planner.transcription.bernstein import bernstein_elevation, bernstein_gram, bernstein_matrix, bernstein_product
from linkplan.planner.transcription.mesh import Layout
from linkplan.planner.transcription.schemes import Scheme
from linkplan.planner.transcription.system import (
    NodeFunctions,
    Pattern,
    System,
    convert_lists,
    nonzeros,
    triplets,
)

# Costs of an interval, exact for its polynomials: its duration, int u_j^2, int u_j'^2, int a_j'^2.
COSTS = ("time", "effort", "effort_rate", "jerk")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class IntervalRows:
    """Costs of an interval, and its rows on Bernstein coefficients, which hold at every instant.

    `costs` are names from `COSTS`. The other fields say which quantities are bounded:

    * `speed_columns`, `position_columns`: second-order coordinates; `state_columns`: first-order states.
    * `acceleration_columns`, `jerk_columns`: second-order coordinates whose acceleration or its rate is bounded.
    * `rate_columns`: efforts whose rate is bounded.
    * `motor_columns`: pairs (effort, coordinate) with the line alpha u + beta v.
    * `power_columns`: pairs (effort, coordinate) with the product u v.
    * `power_levers`: pairs (effort, levers) with the effort times the sum of lever times speed; a lever is a pair
      (algebraic unknown, coordinate).
    * `through_nodes`: pairs (kind, algebraic unknown), as a polynomial through the nodes.
    * `squared_sums`: pairs (kind, algebraic unknowns) with the sum of the squares of such polynomials.
    * `open_end_path`: path quantities that jump with the effort and are therefore bounded at open ends too.
    * `jerk_path`: path quantities that depend on the rates of accelerations.
    * `smooth_columns`: second-order coordinates whose acceleration has no jumps, because a limit or a cost is on its rate.

    Weights, alpha and beta are parameters of the program (eta) and not part of its structure.
    """

    costs: tuple[str, ...] = ()
    speed_columns: tuple[int, ...] = ()
    position_columns: tuple[int, ...] = ()
    state_columns: tuple[int, ...] = ()
    acceleration_columns: tuple[int, ...] = ()
    jerk_columns: tuple[int, ...] = ()
    rate_columns: tuple[int, ...] = ()
    motor_columns: tuple[tuple[int, int], ...] = ()
    power_columns: tuple[tuple[int, int], ...] = ()
    power_levers: tuple[tuple[int, tuple[tuple[int, int], ...]], ...] = ()
    through_nodes: tuple[tuple[str, int], ...] = ()
    squared_sums: tuple[tuple[str, tuple[int, ...]], ...] = ()
    open_end_path: tuple[int, ...] = ()
    jerk_path: tuple[int, ...] = ()
    smooth_columns: tuple[int, ...] = ()

    @property
    def encloses(self) -> bool:
        """Whether limits that can be imposed at every instant are rows on coefficients."""
        return bool(self.power_columns or self.power_levers or self.squared_sums or self.through_nodes)

    def n_eta(self, n_u: int, n_s: int) -> int:
        """Return the number of an interval's own parameters: weights of its costs, then alpha and beta of each motor."""
        return sum({"time": 1, "jerk": n_s}.get(cost, n_u) for cost in self.costs) + 2 * len(self.motor_columns)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ChainFunctions:
    """CasADi functions of one interval that take its nodes' values as inputs, with their sparsity patterns.

    `nodes` (w, share) gives xi of nodes and open ends as columns. `own` (w, share, eta) gives own rows and own cost.
    `chain_jacobian` takes (w, share, eta, node Jacobians, open-end Jacobians). `chain_gradient` takes (w, share, eta,
    running costs, their gradients). `chain_hessian` takes (w, share, eta, lambda_own, sigma, gradients of nodes and open
    ends, node Hessians, open-end Hessians, gradients of the running costs). They depend on the system's sizes and patterns
    only.
    """

    nodes: ca.Function
    own: ca.Function
    chain_jacobian: ca.Function
    chain_gradient: ca.Function
    chain_hessian: ca.Function
    jacobian_pattern: Pattern
    hessian_pattern: Pattern
    n_own: int
    own_kinds: tuple[str, ...]  # per own row: "continuity", "speed", "position", "state", "effort_rate", "power", ...
    own_items: tuple[int, ...]  # per own row: index into the columns of its kind
    lanes: int = 1  # the samples of one call, side by side

    def __post_init__(self) -> None:
        convert_lists(self)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class IntervalFunctions:
    """The functions of one interval (its nodes' and the chain rule's) and a description of its rows."""

    node: NodeFunctions
    chain: ChainFunctions
    n_equations: int
    n_path: int
    n_open_ends: int  # ends without a node
    weights: np.ndarray  # (n_nodes,) of the quadrature
    node_kinds: tuple[str, ...]  # per row of a node: "closure", "dynamics", "speed", or what the system calls it

    @property
    def n_nodes(self) -> int:
        """The number of its nodes."""
        return len(self.weights)

    @property
    def n_own(self) -> int:
        """The number of the interval's own rows."""
        return self.chain.n_own

    @property
    def own_kinds(self) -> tuple[str, ...]:
        """The kind of each own row."""
        return self.chain.own_kinds

    @property
    def own_items(self) -> tuple[int, ...]:
        """The index of each own row into the columns of its kind."""
        return self.chain.own_items

    @property
    def open_end_rows(self) -> tuple[int, ...]:
        """The rows of a node that are imposed at open ends."""
        return self.node.open_end_rows

    @property
    def open_end_z(self) -> tuple[int, ...]:
        """The algebraic unknowns in these rows."""
        return self.node.open_end_z

    @property
    def n_rows(self) -> int:
        """The number of rows: own rows, each node's equations and path quantities, rows at open ends."""
        at_nodes = self.n_nodes * (self.n_equations + self.n_path)
        return self.n_own + at_nodes + self.n_open_ends * len(self.open_end_rows)

    @property
    def compiled(self) -> bool:
        """Whether the nodes' functions, which do most of the work, are compiled."""
        return self.node.node_value.class_name() == "External"


def open_end_path(scheme: Scheme, rows: IntervalRows) -> tuple[int, ...]:
    """Return the path quantities that are imposed at open ends; empty if the scheme has no open ends."""
    return rows.open_end_path if scheme.open_ends else ()


def interval_of(
    system: System, scheme: Scheme, rows: IntervalRows, node: NodeFunctions, chain: ChainFunctions
) -> IntervalFunctions:
    """Return the functions of one interval from those of its nodes and the chain rule's."""
    return IntervalFunctions(
        node=node,
        chain=chain,
        n_equations=system.n_equations,
        n_path=system.n_path,
        n_open_ends=len(scheme.open_ends) if open_end_path(scheme, rows) else 0,
        weights=np.array(scheme.weights),
        node_kinds=system.kinds,
    )


def build_chain(system: System, scheme: Scheme, rows: IntervalRows, node: NodeFunctions) -> ChainFunctions:
    """Return the chain rule's functions of one interval; of `system` and `node` only sizes and patterns matter."""
    m, n_open_ends = scheme.n_nodes, len(scheme.open_ends) if open_end_path(scheme, rows) else 0
    layout = Layout(
        n_s=system.n_s,
        n_x=system.n_x,
        n_z=system.n_z,
        n_u=system.n_u,
        n_nodes=m,
        n_effort=scheme.effort_at.shape[1],
        n_intervals=1,
        n_segments=1,
        n_open_ends=n_open_ends,
        n_z_open_end=len(node.open_end_z),
    )
    w, share, eta = ca.SX.sym("w", layout.size), ca.SX.sym("share"), ca.SX.sym("eta", rows.n_eta(system.n_u, system.n_s))
    parts = _Parts(layout, scheme, w, share)
    xi = parts.node_columns(has_jerk=system.has_jerk)  # (n_xi, m + n_open_ends)
    if n_open_ends:
        xi = ca.horzcat(xi, parts.open_end_columns(scheme, node.open_end_z, has_jerk=system.has_jerk))
    own, kinds, items = _own_rows(parts, scheme, system, rows, eta)
    cost = _own_cost(parts, rows, eta)
    stacked = ca.vec(xi)
    T = ca.jacobian(stacked, w)
    blocks = [T[i * system.n_xi : (i + 1) * system.n_xi, :] for i in range(m + n_open_ends)]

    def sized(name: str, where: Pattern, n_rows: int, count: int) -> tuple[ca.SX, list[ca.SX]]:
        pattern = (
            ca.Sparsity.triplet(n_rows, system.n_xi, *(part.tolist() for part in where)) if count else ca.Sparsity(0, 0)
        )
        entries = ca.SX.sym(name, pattern.nnz(), count)
        return entries, [ca.SX(pattern, entries[:, i]) for i in range(count)]

    J_nodes, J_at_nodes = sized("jacobian", node.jacobian_pattern, system.n_equations + system.n_path, m)
    J_open_ends, J_at_open_ends = sized("jacobian", node.open_end_jacobian_pattern, len(node.open_end_rows), n_open_ends)
    placed = [J @ block for J, block in zip(J_at_nodes + J_at_open_ends, blocks, strict=True)]
    jacobian = ca.vertcat(ca.jacobian(own, w), *placed)

    values, value_gradients = ca.SX.sym("L", 1, m), ca.SX.sym("dL", system.n_xi, m)
    weights = scheme.weights
    h = parts.h
    f = cost + h * sum((weights[i] * values[0, i] for i in range(m)), start=ca.SX(0))
    gradient = ca.gradient(f, w)
    for i in range(m):
        gradient += h * weights[i] * (blocks[i].T @ value_gradients[:, i])

    lam, sigma = ca.SX.sym("lam", own.numel()), ca.SX.sym("sigma")
    g = ca.SX.sym("g", system.n_xi, m + n_open_ends)
    H_nodes, H_at_nodes = sized("hessian", node.hessian_pattern, system.n_xi, m)
    H_open_ends, H_at_open_ends = sized("hessian", node.open_end_hessian_pattern, system.n_xi, n_open_ends)
    hessian = ca.hessian(sigma * cost + ca.dot(lam, own) + ca.dot(ca.vec(g), stacked), w)[0]
    dh = ca.gradient(h, w)
    for upper, block in zip(H_at_nodes + H_at_open_ends, blocks, strict=True):
        hessian += block.T @ (upper + ca.triu(upper, False).T) @ block
    for i in range(m):
        cross = sigma * weights[i] * (dh @ (blocks[i].T @ value_gradients[:, i]).T)
        hessian += cross + cross.T
    hessian = ca.triu(ca.sparsify(hessian))

    def function(name: str, inputs: list, outputs: list) -> ca.Function:
        return ca.Function(name, inputs, outputs, {"cse": True})

    return ChainFunctions(
        nodes=function("nodes", [w, share], [ca.densify(xi)]),
        own=function("own", [w, share, eta], [ca.densify(own), ca.densify(cost)]),
        chain_jacobian=function("chain_jacobian", [w, share, eta, J_nodes, J_open_ends], [nonzeros(jacobian)]),
        chain_gradient=function("chain_gradient", [w, share, eta, values, value_gradients], [ca.densify(gradient)]),
        chain_hessian=function(
            "chain_hessian", [w, share, eta, lam, sigma, g, H_nodes, H_open_ends, value_gradients], [nonzeros(hessian)]
        ),
        jacobian_pattern=triplets(jacobian),
        hessian_pattern=triplets(hessian),
        n_own=own.numel(),
        own_kinds=tuple(kinds),
        own_items=tuple(items),
    )


class _Parts:
    """The unknowns of an interval by kind; rows are nodes or coefficients."""

    def __init__(self, layout: Layout, scheme: Scheme, w: ca.SX, share: ca.SX) -> None:
        n_s = layout.n_s
        left, right = w[: layout.n_state], w[layout.block : layout.block + layout.n_state]

        def row(values: ca.SX) -> ca.SX:
            return ca.reshape(values, 1, values.numel())  # CasADi makes a row of an empty slice of one value

        self.s0, self.v0, self.x0 = row(left[:n_s]), row(left[n_s : 2 * n_s]), row(left[2 * n_s :])
        self.s1, self.v1, self.x1 = row(right[:n_s]), row(right[n_s : 2 * n_s]), row(right[2 * n_s :])

        def rows(indices: np.ndarray) -> ca.SX:
            return ca.reshape(w[[int(i) for i in indices.ravel()]], indices.shape[-1], indices.shape[-2]).T

        self.a, self.r = rows(layout.acceleration()), rows(layout.rate())
        self.z, self.u = rows(layout.dependent()), rows(layout.effort())
        self.open_end_dependent = rows(layout.open_end_dependent())
        self.h, self.nodes = share * w[int(layout.durations()[0])], scheme.nodes
        self.matrix = {n: ca.SX(ca.DM(getattr(scheme, n))) for n in scheme.__slots__ if n not in ("name", "consistent")}

    def jerk_at(self, points: np.ndarray) -> ca.SX:
        """Return the accelerations' rates (n, n_s) at shares (n,) of the interval."""
        coefficients = _slope(self.matrix["acceleration_coefficients"] @ self.a) / self.h
        return ca.DM(bernstein_matrix(coefficients.shape[0] - 1, points)) @ coefficients

    def node_columns(self, *, has_jerk: bool) -> ca.SX:
        """Return xi (n_xi, m) of the interval's nodes."""
        matrix, h = self.matrix, self.h
        m = matrix["nodes"].numel()
        s = ca.repmat(self.s0, m, 1) + h * matrix["nodes"] @ self.v0 + h**2 * matrix["position"] @ self.a
        v = ca.repmat(self.v0, m, 1) + h * matrix["velocity"] @ self.a
        x = ca.repmat(self.x0, m, 1) + h * matrix["velocity"] @ self.r
        u = matrix["effort_at"] @ self.u
        j = [self.jerk_at(self.nodes)] if has_jerk else []
        return ca.horzcat(s, v, self.a, *j, x, self.r, self.z, u).T

    def open_end_columns(self, scheme: Scheme, open_end_z: tuple[int, ...], *, has_jerk: bool) -> ca.SX:
        """Return xi (n_xi, n_open_ends) of the interval's open ends."""
        extrapolate, columns = ca.SX(ca.DM(scheme.at_open_ends)), []
        for i, end in enumerate(scheme.open_ends):
            z = ca.SX.zeros(1, self.z.shape[1])
            for k, j in enumerate(open_end_z):
                z[0, j] = self.open_end_dependent[i, k]
            s, v, x = (self.s1, self.v1, self.x1) if end else (self.s0, self.v0, self.x0)
            a, r = extrapolate[i, :] @ self.a, extrapolate[i, :] @ self.r
            j = [self.jerk_at(np.array([end]))] if has_jerk else []
            columns.append(ca.horzcat(s, v, a, *j, x, r, z, self.u[-1 if end else 0, :]).T)
        return ca.horzcat(*columns)


def _own_rows(parts: _Parts, scheme: Scheme, system: System, rows: IntervalRows, eta: ca.SX):
    """Return the own rows, with the kind and the item of each: continuity, then bounded Bernstein coefficients."""
    h, matrix = parts.h, parts.matrix
    continuity = ca.horzcat(
        parts.s1 - parts.s0 - h * parts.v0 - h**2 * matrix["position_end"].T @ parts.a,
        parts.v1 - parts.v0 - h * matrix["velocity_end"].T @ parts.a,
        parts.x1 - parts.x0 - h * matrix["velocity_end"].T @ parts.r,
    ).T
    own, kinds, items = [continuity], ["continuity"] * system.n_state, list(range(system.n_state))

    def add(kind: str, item: int, coefficients: ca.SX) -> None:
        own.append(coefficients)
        kinds.extend([kind] * coefficients.numel())
        items.extend([item] * coefficients.numel())

    def following(kind: str) -> int:
        return len({item for of, item in zip(kinds, items, strict=True) if of == kind})

    def speed(column: int) -> ca.SX:
        return parts.v0[column] + h * (matrix["velocity_coefficients"] @ parts.a)[:, column]

    for item, column in enumerate(rows.speed_columns):
        add("speed", item, speed(column))
    n = scheme.position_coefficients.shape[0]
    tau = ca.DM(np.arange(n) / (n - 1))  # Bernstein coefficients of tau itself
    for item, column in enumerate(rows.position_columns):
        travelled = h * tau * parts.v0[column] + h**2 * (matrix["position_coefficients"] @ parts.a)[:, column]
        add("position", item, parts.s0[column] + travelled)
    for item, column in enumerate(rows.state_columns):
        add("state", item, parts.x0[column] + h * (matrix["velocity_coefficients"] @ parts.r)[:, column])
    acceleration = matrix["acceleration_coefficients"] @ parts.a
    for item, column in enumerate(rows.acceleration_columns):
        add("acceleration", item, acceleration[:, column])
    for item, column in enumerate(rows.jerk_columns):
        add("jerk", item, _slope(acceleration[:, column]) / h)
    degree = scheme.effort_at.shape[1] - 1
    for item, column in enumerate(rows.rate_columns):
        add("effort_rate", item, _slope(parts.u[:, column]) / h)
    lift = ca.DM(bernstein_elevation(degree, scheme.velocity_coefficients.shape[0] - 1))
    for item, (effort, column) in enumerate(rows.power_columns):
        add("power", item, ca.vertcat(*bernstein_product(parts.u[:, effort], speed(column))))
    through_nodes = ca.DM(np.linalg.inv(bernstein_matrix(scheme.n_nodes - 1, np.array(scheme.nodes))))
    for effort, levers in rows.power_levers:
        parts_of_speed = [bernstein_product(through_nodes @ parts.z[:, lever], speed(column)) for lever, column in levers]
        whole = ca.vertcat(*(sum(terms) for terms in zip(*parts_of_speed, strict=True)))
        add("power", following("power"), ca.vertcat(*bernstein_product(parts.u[:, effort], whole)))
    for kind, unknown in rows.through_nodes:
        add(kind, following(kind), through_nodes @ parts.z[:, unknown])
    for kind, unknowns in rows.squared_sums:
        squares = [bernstein_product(one, one) for one in (through_nodes @ parts.z[:, k] for k in unknowns)]
        total = [functools.reduce(operator.add, terms) for terms in zip(*squares, strict=True)]
        add(kind, following(kind), ca.vertcat(*total))
    first = eta.numel() - 2 * len(rows.motor_columns)
    for item, (effort, column) in enumerate(rows.motor_columns):
        alpha, beta = eta[first + 2 * item], eta[first + 2 * item + 1]
        add("motor", item, alpha * (lift @ parts.u[:, effort]) + beta * speed(column))
    return ca.densify(ca.vertcat(*own)), kinds, items


def _own_cost(parts: _Parts, rows: IntervalRows, eta: ca.SX) -> ca.SX:
    """Return the interval's weighted costs, with exact integrals of its polynomials."""
    squares = {
        "effort": (parts.u, parts.h),
        "effort_rate": (_slope(parts.u), 1 / parts.h),
        "jerk": (_slope(parts.matrix["acceleration_coefficients"] @ parts.a), 1 / parts.h),
    }
    cost, at = ca.SX(0), 0
    for name in rows.costs:
        if name == "time":
            cost += eta[at] * parts.h
            at += 1
            continue
        values, factor = squares[name]
        gram = ca.DM(bernstein_gram(max(values.shape[0] - 1, 0)))
        for j in range(values.shape[1]):
            if values.shape[0]:  # a constant has no slope
                cost += eta[at + j] * factor * (values[:, j].T @ gram @ values[:, j])
        at += values.shape[1]
    return cost


def _slope(coefficients: ca.SX) -> ca.SX:
    """Return the Bernstein coefficients of a polynomial's derivative by the share of the interval."""
    return (coefficients.shape[0] - 1) * (coefficients[1:, :] - coefficients[:-1, :])
