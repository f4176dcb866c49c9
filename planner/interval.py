"""One interval of a transcription: from its unknowns to its nodes, its own rows, and the chain rule back.

The unknowns of an interval, all scaled, are w = [left state (s, v, x); nodal accelerations, nodal rates, nodal algebraic
unknowns; Bernstein coefficients of the effort; right state; duration of its segment], and h = share * duration its width.
Nodes are polynomials in w (linear but for h), so that the expensive functions, those of the system at a node, are
differentiated once and for one node, and the interval's derivatives follow by matrix products:

    J = [J_own; J_i T_i],   H = H_own + sum_i T_i^T H_i T_i + sum_k g_ik d2 xi_ik / dw2,   T_i = d xi_i / dw.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from planner.schemes import Scheme, bernstein_gram
from planner.system import System

# Weight of the squared effort rate in a tracking objective, all in scaled units. Where limits bind, the motion nearest in
# position alone chatters at the ends of its bang arcs (Fuller's phenomenon); with this weight, a swing over the whole
# limit in a tenth of the motion costs as much as an rms error of 3e-4 of the motion's span, and the effort is smooth.
SMOOTHING = 2.5e-9


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class IntervalRows:
    """What an interval adds of its own: costs of the effort's polynomial, and rows on Bernstein coefficients.

    `effort_weight` (n_u,) multiplies int u^2, `rate_weight` int u'^2 (scaled); `speed_columns` are second-order
    coordinates whose velocity is to be bounded at every instant, `position_rows` says whether all positions are.
    """

    effort_weight: tuple[float, ...]
    rate_weight: float = 0.0
    speed_columns: tuple[int, ...] = ()
    position_rows: bool = False


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Layout:
    """Where the unknowns of each interval stand in the whole vector."""

    n_s: int
    n_z: int
    n_u: int
    n_nodes: int
    n_intervals: int
    n_segments: int
    n_x: int = 0
    n_effort: int = 0  # Bernstein coefficients of each effort; as many as nodes where 0
    n_extra: int = 0  # unknowns of the whole program beyond its last state and durations

    @property
    def n_state(self) -> int:
        """The number of states at an interval's end."""
        return 2 * self.n_s + self.n_x

    @property
    def effort_coefficients(self) -> int:
        """The number of Bernstein coefficients of an effort on an interval."""
        return self.n_effort or self.n_nodes

    @property
    def block(self) -> int:
        """The number of unknowns that belong to one interval, its left state included."""
        inner = self.n_nodes * (self.n_s + self.n_x + self.n_z) + self.effort_coefficients * self.n_u
        return self.n_state + inner

    @property
    def size(self) -> int:
        """The number of unknowns."""
        return self.n_intervals * self.block + self.n_state + self.n_segments + self.n_extra

    def state(self, k: int) -> np.ndarray:
        """Return the indices (n_state,) of state k, 0 to n_intervals."""
        return k * self.block + np.arange(self.n_state)

    def states(self) -> np.ndarray:
        """Return indices (n_intervals + 1, n_state): s, v, x."""
        return np.array([self.state(k) for k in range(self.n_intervals + 1)])

    def acceleration(self) -> np.ndarray:
        """Return indices (n_intervals, n_nodes, n_s)."""
        return self._inner(self.n_state, self.n_nodes, self.n_s)

    def rate(self) -> np.ndarray:
        """Return indices (n_intervals, n_nodes, n_x) of the first-order states' rates."""
        return self._inner(self.n_state + self.n_nodes * self.n_s, self.n_nodes, self.n_x)

    def dependent(self) -> np.ndarray:
        """Return indices (n_intervals, n_nodes, n_z)."""
        return self._inner(self.n_state + self.n_nodes * (self.n_s + self.n_x), self.n_nodes, self.n_z)

    def effort(self) -> np.ndarray:
        """Return indices (n_intervals, n_coefficients, n_u) of Bernstein coefficients."""
        start = self.n_state + self.n_nodes * (self.n_s + self.n_x + self.n_z)
        return self._inner(start, self.effort_coefficients, self.n_u)

    def durations(self) -> np.ndarray:
        """Return the indices (n_segments,) of the segments' durations."""
        return self.size - self.n_extra - self.n_segments + np.arange(self.n_segments)

    def extra(self) -> np.ndarray:
        """Return the indices (n_extra,) of the whole program's further unknowns."""
        return self.size - self.n_extra + np.arange(self.n_extra)

    def _inner(self, start: int, count: int, width: int) -> np.ndarray:
        inner = np.arange(count * width).reshape(count, width)
        return start + self.block * np.arange(self.n_intervals)[:, None, None] + inner


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class IntervalFunctions:
    """CasADi functions of one node and one interval, nonzeros as dense columns, and where the nonzeros stand.

    Node: `node_value` (xi, theta); `node_jacobian` (xi, theta), with the running cost's gradient; `node_hessian` (xi, theta,
    lambda), gradient and upper triangle. Interval: `nodes` (w, share), xi side by side; `own` (w, share), own rows and own
    cost; `chain_jacobian` (w, share, node Jacobians), `chain_gradient` (w, share, running costs, their gradients),
    `chain_hessian` (w, share, lambda_own, sigma, node gradients, node Hessians, gradients of the running costs).
    """

    node_value: ca.Function
    node_jacobian: ca.Function
    node_hessian: ca.Function
    nodes: ca.Function
    own: ca.Function
    chain_jacobian: ca.Function
    chain_gradient: ca.Function
    chain_hessian: ca.Function
    jacobian_pattern: tuple[np.ndarray, np.ndarray]
    hessian_pattern: tuple[np.ndarray, np.ndarray]
    n_own: int
    n_equations: int
    n_path: int
    n_nodes: int
    weights: np.ndarray
    own_kinds: tuple[str, ...]  # per own row: "continuity", "speed", "position"
    node_kinds: tuple[str, ...]  # per row of a node: "closure", "dynamics", "speed", or what the system calls it

    @property
    def n_rows(self) -> int:
        """The number of an interval's rows: its own, then each node's equations and path quantities."""
        return self.n_own + self.n_nodes * (self.n_equations + self.n_path)

    @property
    def row_kinds(self) -> tuple[str, ...]:
        """What each of an interval's rows is."""
        return self.own_kinds + self.n_nodes * self.node_kinds


NAMES = (
    "node_value",
    "node_jacobian",
    "node_hessian",
    "nodes",
    "own",
    "chain_jacobian",
    "chain_gradient",
    "chain_hessian",
)


def build_interval(system: System, scheme: Scheme, rows: IntervalRows) -> IntervalFunctions:
    """Return the functions of one interval of a system under a transcription."""
    node = _node_functions(system)
    m = scheme.n_nodes
    layout = Layout(
        n_s=system.n_s,
        n_x=system.n_x,
        n_z=system.n_z,
        n_u=system.n_u,
        n_nodes=m,
        n_effort=scheme.effort_at.shape[1],
        n_intervals=1,
        n_segments=1,
    )
    w, share = ca.SX.sym("w", layout.size), ca.SX.sym("share")
    parts = _Parts(layout, scheme, w, share)
    xi = parts.node_columns()  # (n_xi, m)
    own, kinds = _own_rows(parts, scheme, system, rows)
    cost = _own_cost(parts, scheme, rows)
    stacked = ca.vec(xi)
    T = ca.jacobian(stacked, w)
    blocks = [T[i * system.n_xi : (i + 1) * system.n_xi, :] for i in range(m)]

    J_pattern, H_pattern = node["jacobian_sparsity"], node["hessian_sparsity"]
    J_nz = ca.SX.sym("J", J_pattern.nnz(), m)
    jacobian_rows = [ca.jacobian(own, w)]
    for i in range(m):
        J_i = ca.SX(J_pattern, J_nz[:, i])
        jacobian_rows.append(J_i @ blocks[i])
    jacobian = ca.vertcat(*jacobian_rows)

    values, value_gradients = ca.SX.sym("L", 1, m), ca.SX.sym("dL", system.n_xi, m)
    weights = scheme.weights
    h = parts.h
    f = cost + h * sum((weights[i] * values[0, i] for i in range(m)), start=ca.SX(0))
    gradient = ca.gradient(f, w)
    for i in range(m):
        gradient += h * weights[i] * (blocks[i].T @ value_gradients[:, i])

    lam, sigma = ca.SX.sym("lam", own.numel()), ca.SX.sym("sigma")
    g = ca.SX.sym("g", system.n_xi, m)
    H_nz = ca.SX.sym("H", H_pattern.nnz(), m)
    hessian = ca.hessian(sigma * cost + ca.dot(lam, own) + ca.dot(ca.vec(g), stacked), w)[0]
    dh = ca.gradient(h, w)
    for i in range(m):
        upper = ca.SX(H_pattern, H_nz[:, i])
        full = upper + ca.triu(upper, False).T
        hessian += blocks[i].T @ full @ blocks[i]
        cross = sigma * weights[i] * (dh @ (blocks[i].T @ value_gradients[:, i]).T)
        hessian += cross + cross.T
    hessian = ca.triu(ca.sparsify(hessian))

    def function(name: str, inputs: list, outputs: list) -> ca.Function:
        return ca.Function(name, inputs, outputs, {"cse": True})

    return IntervalFunctions(
        node_value=node["value"],
        node_jacobian=node["jacobian"],
        node_hessian=node["hessian"],
        nodes=function("nodes", [w, share], [ca.densify(xi)]),
        own=function("own", [w, share], [ca.densify(own), ca.densify(cost)]),
        chain_jacobian=function("chain_jacobian", [w, share, J_nz], [_nonzeros(jacobian)]),
        chain_gradient=function("chain_gradient", [w, share, values, value_gradients], [ca.densify(gradient)]),
        chain_hessian=function("chain_hessian", [w, share, lam, sigma, g, H_nz, value_gradients], [_nonzeros(hessian)]),
        jacobian_pattern=_triplets(jacobian),
        hessian_pattern=_triplets(hessian),
        n_own=own.numel(),
        n_equations=system.n_equations,
        n_path=system.n_path,
        n_nodes=m,
        weights=np.array(weights),
        own_kinds=tuple(kinds),
        node_kinds=system.kinds,
    )


def _node_functions(system: System) -> dict:
    """Return a node's value, Jacobian and Hessian functions and the latter two's patterns."""
    xi, theta = ca.SX.sym("xi", system.n_xi), ca.SX.sym("theta", system.n_theta)
    F = ca.densify(system.node(xi, theta))
    n_f = system.n_equations + system.n_path
    jacobian, running = ca.jacobian(F[:n_f], xi), ca.densify(ca.gradient(F[n_f], xi))
    lam = ca.SX.sym("lam", F.numel())
    hessian, gradient = ca.hessian(ca.dot(lam, F), xi)
    hessian = ca.triu(hessian)
    return {
        "value": ca.Function("node_value", [xi, theta], [F], {"cse": True}),
        "jacobian": ca.Function("node_jacobian", [xi, theta], [_nonzeros(jacobian), running], {"cse": True}),
        "hessian": ca.Function("node_hessian", [xi, theta, lam], [ca.densify(gradient), _nonzeros(hessian)], {"cse": True}),
        "jacobian_sparsity": jacobian.sparsity(),
        "hessian_sparsity": hessian.sparsity(),
    }


class _Parts:
    """An interval's unknowns taken apart: rows are nodes or coefficients."""

    def __init__(self, layout: Layout, scheme: Scheme, w: ca.SX, share: ca.SX) -> None:
        n_s = layout.n_s
        left, right = w[: layout.n_state], w[layout.block : layout.block + layout.n_state]
        self.s0, self.v0, self.x0 = left[:n_s].T, left[n_s : 2 * n_s].T, left[2 * n_s :].T
        self.s1, self.v1, self.x1 = right[:n_s].T, right[n_s : 2 * n_s].T, right[2 * n_s :].T

        def rows(indices: np.ndarray) -> ca.SX:
            return ca.reshape(w[[int(i) for i in indices.ravel()]], indices.shape[-1], indices.shape[-2]).T

        self.a, self.r = rows(layout.acceleration()), rows(layout.rate())
        self.z, self.u = rows(layout.dependent()), rows(layout.effort())
        self.h = share * w[int(layout.durations()[0])]
        self.matrix = {n: ca.SX(ca.DM(getattr(scheme, n))) for n in scheme.__slots__ if n not in ("name", "consistent")}

    def node_columns(self) -> ca.SX:
        """Return xi (n_xi, m) of the interval's nodes."""
        matrix, h = self.matrix, self.h
        m = matrix["nodes"].numel()
        s = ca.repmat(self.s0, m, 1) + h * matrix["nodes"] @ self.v0 + h**2 * matrix["position"] @ self.a
        v = ca.repmat(self.v0, m, 1) + h * matrix["velocity"] @ self.a
        x = ca.repmat(self.x0, m, 1) + h * matrix["velocity"] @ self.r
        u = matrix["effort_at"] @ self.u
        return ca.horzcat(s, v, self.a, x, self.r, self.z, u).T


def _own_rows(parts: _Parts, scheme: Scheme, system: System, rows: IntervalRows) -> tuple[ca.SX, list[str]]:
    """Return the interval's own rows: continuity to the next state, then bounded Bernstein coefficients."""
    h, matrix = parts.h, parts.matrix
    continuity = ca.horzcat(
        parts.s1 - parts.s0 - h * parts.v0 - h**2 * matrix["position_end"].T @ parts.a,
        parts.v1 - parts.v0 - h * matrix["velocity_end"].T @ parts.a,
        parts.x1 - parts.x0 - h * matrix["velocity_end"].T @ parts.r,
    ).T
    own, kinds = [continuity], ["continuity"] * system.n_state
    for column in rows.speed_columns:
        coefficients = parts.v0[column] + h * (matrix["velocity_coefficients"] @ parts.a)[:, column]
        own.append(coefficients)
        kinds += ["speed"] * coefficients.numel()
    if rows.position_rows:
        n = scheme.position_coefficients.shape[0]
        tau = ca.DM(np.arange(n) / (n - 1))  # Bernstein coefficients of tau itself
        coefficients = ca.repmat(parts.s0, n, 1) + h * tau @ parts.v0 + h**2 * matrix["position_coefficients"] @ parts.a
        own.append(ca.vec(coefficients))
        kinds += ["position"] * coefficients.numel()
    return ca.densify(ca.vertcat(*own)), kinds


def _own_cost(parts: _Parts, scheme: Scheme, rows: IntervalRows) -> ca.SX:
    """Return the integrals of the squared effort and of its squared rate, exact for the effort's polynomial."""
    degree = scheme.effort_at.shape[1] - 1
    cost = ca.SX(0)
    gram = ca.DM(bernstein_gram(degree))
    for j, weight in enumerate(rows.effort_weight):
        if weight:
            cost += weight * parts.h * (parts.u[:, j].T @ gram @ parts.u[:, j])
    if rows.rate_weight and degree > 0:
        gram, slope = ca.DM(bernstein_gram(degree - 1)), degree * (parts.u[1:, :] - parts.u[:-1, :])
        cost += rows.rate_weight / parts.h * ca.trace(slope.T @ gram @ slope)
    return cost


def _nonzeros(matrix: ca.SX) -> ca.SX:
    """Return a matrix's nonzeros as a column (CasADi gives a row for a row)."""
    return ca.vec(matrix.nz[:])


def _triplets(matrix: ca.SX) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = matrix.sparsity().get_triplet()
    return np.array(rows, dtype=int), np.array(columns, dtype=int)
