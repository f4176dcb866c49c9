"""The nonlinear program of a planning problem: one local function per interval, assembled by index.

Unknowns of interval k are its left state x_k = (s, v), nodal accelerations, nodal dependent positions z (lifted: tied
by phi(s, z) = 0, so the loop is closed at every node and no multiplier enters) and the effort's Bernstein coefficients;
then come the last state and the segments' durations. A local function gives an interval's constraints

    s_{k+1} - s(1),   v_{k+1} - v(1),   phi(q_i),   inverse_dynamics(q_i, v_i, a_i) - Gamma^T B u_i

and its share of the objective, all scaled. Its first and second derivatives are taken once, symbolically, mapped over the
intervals, and their nonzeros are put in place by a permutation: building costs the same for 10 intervals as for 1,000,
and no graph colouring is run. Rows that are linear in the unknowns (periodicity, total duration) are appended.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.sparse as sp

from models.mechanism import Mechanism
from planner.mesh import Mesh
from planner.schemes import Scheme, bernstein_gram

# Weight of the squared effort rate in a tracking objective, all in scaled units. Where limits bind, the motion nearest in
# position alone chatters at the ends of its bang arcs (Fuller's phenomenon); with this weight, a swing over the whole
# limit in a tenth of the motion costs as much as an rms error of 3e-4 of the motion's span, and the effort is smooth.
SMOOTHING = 2.5e-9


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

    def vector(self) -> np.ndarray:
        """Return the scales as the parameter vector of the local function."""
        return np.concatenate([[self.time_s], self.position, self.effort, self.residual, [self.length_m]])


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Layout:
    """Where the unknowns of each interval stand in the whole vector."""

    n_s: int
    n_z: int
    n_u: int
    n_nodes: int
    n_intervals: int
    n_segments: int
    n_extra: int = 0  # unknowns of the whole program beyond its last state and durations

    @property
    def block(self) -> int:
        """The number of unknowns that belong to one interval, its left state included."""
        return 2 * self.n_s + self.n_nodes * (self.n_s + self.n_z + self.n_u)

    @property
    def size(self) -> int:
        """The number of unknowns."""
        return self.n_intervals * self.block + 2 * self.n_s + self.n_segments + self.n_extra

    def state(self, k: int) -> np.ndarray:
        """Return the indices (2 n_s,) of state k, 0 to n_intervals."""
        return k * self.block + np.arange(2 * self.n_s)

    def acceleration(self) -> np.ndarray:
        """Return indices (n_intervals, n_nodes, n_s)."""
        return self._inner(2 * self.n_s, self.n_s)

    def dependent(self) -> np.ndarray:
        """Return indices (n_intervals, n_nodes, n_z)."""
        return self._inner(2 * self.n_s + self.n_nodes * self.n_s, self.n_z)

    def effort(self) -> np.ndarray:
        """Return indices (n_intervals, n_nodes, n_u) of Bernstein coefficients."""
        return self._inner(2 * self.n_s + self.n_nodes * (self.n_s + self.n_z), self.n_u)

    def durations(self) -> np.ndarray:
        """Return the indices (n_segments,) of the segments' durations."""
        return self.size - self.n_extra - self.n_segments + np.arange(self.n_segments)

    def extra(self) -> np.ndarray:
        """Return the indices (n_extra,) of the whole program's further unknowns."""
        return self.size - self.n_extra + np.arange(self.n_extra)

    def states(self) -> np.ndarray:
        """Return indices (n_intervals + 1, 2 n_s)."""
        return np.array([self.state(k) for k in range(self.n_intervals + 1)])

    def _inner(self, start: int, width: int) -> np.ndarray:
        inner = np.arange(self.n_nodes * width).reshape(self.n_nodes, width)
        return start + self.block * np.arange(self.n_intervals)[:, None, None] + inner


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class LocalProblem:
    """Functions of one interval over its local unknowns (block, next state, duration), all nonzeros dense vectors.

    Parameters are (share of the segment, reference at the nodes, scales).
    """

    constraints: ca.Function  # w, p -> g
    value: ca.Function  # w, p -> g, f
    jacobian: ca.Function  # w, p -> g, nonzeros of dg/dw
    gradient: ca.Function  # w, p -> f, df/dw
    hessian: ca.Function  # w, p, lambda, sigma -> nonzeros of the Lagrangian's Hessian, upper triangle
    jacobian_pattern: tuple[np.ndarray, np.ndarray]
    hessian_pattern: tuple[np.ndarray, np.ndarray]
    n_constraints: int
    row_kinds: tuple[str, ...]  # per row: "continuity", "closure", "dynamics", "speed", "position"


def build_local(
    mechanism: Mechanism, scheme: Scheme, objective: str, speed_joints: tuple[int, ...], position_rows: bool
) -> LocalProblem:
    """Return the functions of one interval.

    Args:
        mechanism: whose reduced dynamics are to hold at the nodes.
        scheme: the transcription.
        objective: "effort", "tracking" or "none" (a duration is added by the whole program).
        speed_joints: joints whose speeds are rows: Bernstein coefficients for an independent joint, which bounds it
            between the nodes too; values at the nodes for a dependent one.
        position_rows: whether Bernstein coefficients of the independent positions are rows.
    """
    n_s, n_z, n_u, m = mechanism.dof, mechanism.n_q - mechanism.dof, mechanism.n_u, scheme.n_nodes
    layout = Layout(n_s=n_s, n_z=n_z, n_u=n_u, n_nodes=m, n_intervals=1, n_segments=1)
    w = ca.SX.sym("w", layout.size)
    p = ca.SX.sym("p", 1 + m * n_s + 1 + 2 * n_s + n_u + 1)
    share, reference = p[0], ca.reshape(p[1 : 1 + m * n_s], n_s, m).T
    scales = p[1 + m * n_s :]
    t_scale, s_scale = scales[0], scales[1 : 1 + n_s]
    u_scale, r_scale = scales[1 + n_s : 1 + n_s + n_u], scales[1 + n_s + n_u : 1 + 2 * n_s + n_u]
    length = scales[1 + 2 * n_s + n_u]

    def rows(indices: np.ndarray) -> ca.SX:
        return ca.reshape(w[[int(i) for i in indices.ravel()]], indices.shape[-1], m).T

    left, right = w[0 : 2 * n_s], w[layout.block : layout.block + 2 * n_s]
    s0, v0, s1, v1 = left[:n_s].T, left[n_s:].T, right[:n_s].T, right[n_s:].T
    a, z, u_coefficients = rows(layout.acceleration()), rows(layout.dependent()), rows(layout.effort())
    h = share * w[int(layout.durations()[0])]
    matrix = {name: ca.SX(ca.DM(getattr(scheme, name))) for name in scheme.__slots__ if name != "name"}
    s = ca.repmat(s0, m, 1) + h * matrix["nodes"] @ v0 + h**2 * matrix["position"] @ a
    v = ca.repmat(v0, m, 1) + h * matrix["velocity"] @ a
    u = matrix["effort_at"] @ u_coefficients

    dynamics = mechanism.dynamics
    order = np.argsort(np.concatenate([mechanism.independent, mechanism.dependent]))
    rate = s_scale / t_scale

    def pose(i: int) -> ca.SX:
        stacked = ca.vertcat(s[i, :].T * s_scale, z[i, :].T)
        return stacked[[int(j) for j in order]]

    constraints = [s1 - s0 - h * v0 - h**2 * matrix["position_end"].T @ a, v1 - v0 - h * matrix["velocity_end"].T @ a]
    constraints = [row.T for row in constraints]
    kinds = ["continuity"] * (2 * n_s)
    for i in range(m):
        q = pose(i)
        constraints.append(dynamics.independent_closure(q) / length)
        residual = dynamics.residual(q, v[i, :].T * rate, a[i, :].T * rate / t_scale, u[i, :].T * u_scale)
        constraints.append(residual / r_scale)
        kinds += ["closure"] * n_z + ["dynamics"] * n_s
    for joint in speed_joints:
        if joint in mechanism.independent:
            column = int(np.flatnonzero(mechanism.independent == joint)[0])
            coefficients = v0[column] + h * (matrix["velocity_coefficients"] @ a)[:, column]
            constraints.append(coefficients * rate[column])
            kinds += ["speed"] * (m + 1)
        else:
            speeds = [dynamics.velocity_map(pose(i))[joint, :] @ (v[i, :].T * rate) for i in range(m)]
            constraints.append(ca.vertcat(*speeds))
            kinds += ["speed"] * m
    if position_rows:
        tau = ca.DM(np.arange(m + 2) / (m + 1))  # Bernstein coefficients of tau itself
        coefficients = ca.repmat(s0, m + 2, 1) + h * tau @ v0 + h**2 * matrix["position_coefficients"] @ a
        constraints.append(ca.vec(coefficients))
        kinds += ["position"] * ((m + 2) * n_s)
    g = ca.vertcat(*constraints)

    if objective == "effort":
        gram = ca.DM(bernstein_gram(m - 1))
        share_of = (u_scale / ca.mmax(u_scale)) ** 2
        f = h * sum(
            (share_of[j] * (u_coefficients[:, j].T @ gram @ u_coefficients[:, j]) for j in range(n_u)), start=ca.SX(0)
        )
    elif objective == "tracking":
        share_of = (s_scale / ca.mmax(s_scale)) ** 2
        f = h * ca.dot(matrix["weights"], ((s - reference) ** 2) @ share_of)
        if m > 1:  # the effort's rate: u' has Bernstein coefficients (m - 1) diff(u) / h
            gram, rate_of = ca.DM(bernstein_gram(m - 2)), (m - 1) * (u_coefficients[1:, :] - u_coefficients[:-1, :])
            f += SMOOTHING / h * ca.trace(rate_of.T @ gram @ rate_of)
    else:
        f = ca.SX(0)

    lam, sigma = ca.SX.sym("lam", g.numel()), ca.SX.sym("sigma")
    jacobian = ca.jacobian(g, w)
    gradient = ca.densify(ca.gradient(f, w))
    hessian = ca.triu(ca.hessian(sigma * f + ca.dot(lam, g), w)[0])
    g, f = ca.densify(g), ca.densify(f)
    return LocalProblem(
        constraints=ca.Function("constraints", [w, p], [g]),
        value=ca.Function("value", [w, p], [g, f]),
        jacobian=ca.Function("jacobian", [w, p], [g, jacobian.nz[:]]),
        gradient=ca.Function("gradient", [w, p], [f, gradient]),
        hessian=ca.Function("hessian", [w, p, lam, sigma], [hessian.nz[:]]),
        jacobian_pattern=_triplets(jacobian),
        hessian_pattern=_triplets(hessian),
        n_constraints=g.numel(),
        row_kinds=tuple(kinds),
    )


def _triplets(matrix: ca.SX) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = matrix.sparsity().get_triplet()
    return np.array(rows, dtype=int), np.array(columns, dtype=int)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Program:
    """A program that is built: CasADi functions of all unknowns x and parameters p, ready for a solver."""

    layout: Layout
    local: LocalProblem
    mesh: Mesh
    functions: dict[str, ca.Function]  # "nlp", "grad_f", "jac_g", "hess_lag"
    n_rows: int
    linear: sp.csr_matrix


def build_program(layout: Layout, mesh: Mesh, local: LocalProblem, linear: sp.spmatrix, cost: np.ndarray) -> Program:
    """Return the program over a mesh.

    Args:
        layout: where the unknowns stand.
        mesh: intervals and segments.
        local: from `build_local`.
        linear: appended rows (n_linear, n) that are linear in the unknowns.
        cost: gradient (n,) of the objective's linear part, which durations enter.
    """
    n = mesh.n_intervals
    gather = _gather(layout, mesh)  # (n, n_local) index of each local unknown
    x, p = ca.MX.sym("x", layout.size), ca.MX.sym("p", local.constraints.size1_in(1) * n)
    w = ca.reshape(x[gather.ravel().tolist()], gather.shape[1], n)
    P = ca.reshape(p, -1, n)
    linear = sp.csr_matrix(linear)
    A = _casadi_sparse(linear)
    c = ca.DM(cost)

    g_all, f_all = local.value.map(n)(w, P)
    g = ca.vertcat(ca.vec(g_all), A @ x)
    f = ca.sum2(f_all) + ca.dot(c, x)

    # Jacobian: nonzeros of the local Jacobians side by side, then the linear rows', permuted into column order.
    rows, columns = local.jacobian_pattern
    global_rows = (rows[None, :] + local.n_constraints * np.arange(n)[:, None]).ravel()
    global_columns = gather[:, columns].ravel()
    extra = sp.coo_matrix(linear)
    global_rows = np.concatenate([global_rows, extra.row + n * local.n_constraints])
    global_columns = np.concatenate([global_columns, extra.col])
    n_rows = n * local.n_constraints + linear.shape[0]
    jac_g_all, jac_values = local.jacobian.map(n)(w, P)
    values = ca.vertcat(ca.vec(jac_values), ca.DM(extra.data))
    jacobian = _assemble(values, global_rows, global_columns, (n_rows, layout.size))
    g_of_jac = ca.vertcat(ca.vec(jac_g_all), A @ x)
    jac_g = ca.Function("nlp_jac_g", [x, p], [g_of_jac, jacobian], ["x", "p"], ["g", "jac_g_x"])

    f_values, gradients = local.gradient.map(n)(w, P)
    scatter = _scatter(gather.ravel(), layout.size)
    gradient = scatter @ ca.vec(gradients) + c
    grad_f = ca.Function("nlp_grad_f", [x, p], [ca.sum2(f_values) + ca.dot(c, x), gradient], ["x", "p"], ["f", "grad_f_x"])

    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", n_rows)
    rows, columns = local.hessian_pattern
    lam_local = ca.reshape(lam_g[: n * local.n_constraints], local.n_constraints, n)
    hess_values = local.hessian.map(n)(w, P, lam_local, ca.repmat(lam_f, 1, n))
    first, second = gather[:, rows].ravel(), gather[:, columns].ravel()
    hessian = _assemble(
        ca.vec(hess_values), np.minimum(first, second), np.maximum(first, second), (layout.size, layout.size)
    )
    hess = ca.Function("nlp_hess_l", [x, p, lam_f, lam_g], [hessian], ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"])
    return Program(
        layout=layout,
        local=local,
        mesh=mesh,
        functions={
            "nlp": ca.Function("nlp", [x, p], [f, g], ["x", "p"], ["f", "g"]),
            "grad_f": grad_f,
            "jac_g": jac_g,
            "hess_lag": hess,
        },
        n_rows=n_rows,
        linear=linear,
    )


def _gather(layout: Layout, mesh: Mesh) -> np.ndarray:
    n = layout.n_intervals
    block = np.arange(n)[:, None] * layout.block + np.arange(layout.block + 2 * layout.n_s)
    return np.hstack([block, layout.durations()[mesh.segment][:, None]])


def _casadi_sparse(matrix: sp.spmatrix) -> ca.DM:
    csc = sp.csc_matrix(matrix)
    csc.sort_indices()
    sparsity = ca.Sparsity(csc.shape[0], csc.shape[1], csc.indptr.tolist(), csc.indices.tolist())
    return ca.DM(sparsity, csc.data)


def _scatter(target: np.ndarray, size: int) -> ca.DM:
    """Return the matrix (size, n) that adds value i to place target[i]."""
    n = len(target)
    return _casadi_sparse(sp.coo_matrix((np.ones(n), (target, np.arange(n))), shape=(size, n)))


def _assemble(values: ca.MX, rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]) -> ca.MX:
    """Return the sparse matrix of triplets, equal places added."""
    key = columns * shape[0] + rows
    places, inverse = np.unique(key, return_inverse=True)
    pattern = sp.csc_matrix((np.ones(len(places)), (places % shape[0], places // shape[0])), shape=shape)
    pattern.sort_indices()
    sparsity = ca.Sparsity(shape[0], shape[1], pattern.indptr.tolist(), pattern.indices.tolist())
    if len(places) == len(key):
        order = np.empty(len(key), dtype=int)
        order[inverse] = np.arange(len(key))
        return ca.MX(sparsity, values[order.tolist()])
    return ca.MX(sparsity, _scatter(inverse, len(places)) @ values)
