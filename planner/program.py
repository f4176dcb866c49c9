"""The nonlinear program over a mesh: an interval's functions, mapped and put in place by index.

Unknowns are the intervals' (left state, nodal accelerations, nodal dependent positions z lifted and tied by phi(s, z) = 0,
Bernstein coefficients of the effort), then the last state, the segments' durations, and what a whole program adds. The
first and second derivatives of one node and one interval are taken once, symbolically, mapped over all of them, and their
nonzeros are put in place by a permutation: building costs the same for 10 intervals as for 1,000, and no graph colouring
is run. Rows that are linear in the unknowns (periodicity, total duration) are appended.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.sparse as sp

from planner.interval import IntervalFunctions, Layout
from planner.mesh import Mesh


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Program:
    """A program that is built: CasADi functions of all unknowns x and parameters p, ready for a solver.

    Parameters are, per interval, its share of the segment and the parameters of its nodes.
    """

    layout: Layout
    interval: IntervalFunctions
    mesh: Mesh
    functions: dict[str, ca.Function]  # "nlp", "grad_f", "jac_g", "hess_lag"
    n_rows: int
    linear: sp.csr_matrix


def build_program(layout: Layout, mesh: Mesh, interval: IntervalFunctions, linear: sp.spmatrix, cost: np.ndarray) -> Program:
    """Return the program over a mesh.

    Args:
        layout: where the unknowns stand.
        mesh: intervals and segments.
        interval: from `build_interval`.
        linear: appended rows (n_linear, n) that are linear in the unknowns.
        cost: gradient (n,) of the objective's linear part, which durations enter.
    """
    n, m, n_f = mesh.n_intervals, interval.n_nodes, interval.n_equations + interval.n_path
    n_xi, n_theta = interval.node_value.size1_in(0), interval.node_value.size1_in(1)
    gather = _gather(layout, mesh)  # (n, n_w) index of each interval's unknowns
    x, p = ca.MX.sym("x", layout.size), ca.MX.sym("p", (1 + m * n_theta) * n)
    w = ca.reshape(x[gather.ravel().tolist()], gather.shape[1], n)
    P = ca.reshape(p, 1 + m * n_theta, n)
    share, theta = P[0, :], ca.reshape(P[1:, :], n_theta, m * n)
    linear = sp.csr_matrix(linear)
    A, c = _casadi_sparse(linear), ca.DM(cost)
    xi = ca.reshape(interval.nodes.map(n)(w, share), n_xi, m * n)

    node_rows = interval.node_value.map(m * n)(xi, theta)
    own_rows, own_costs = interval.own.map(n)(w, share)
    g_nodes = ca.reshape(node_rows[:n_f, :], m * n_f, n)
    g = ca.vertcat(ca.vec(ca.vertcat(own_rows, g_nodes)), A @ x)
    running = ca.reshape(node_rows[n_f, :], m, n)
    h = share * x[layout.durations()[mesh.segment].tolist()].T
    f = ca.sum2(own_costs) + ca.dot(h, ca.DM(interval.weights).T @ running) + ca.dot(c, x)

    # CasADi's map deals columns out in order: nodes k m to (k + 1) m - 1 are interval k's.
    # Jacobian: nonzeros of the intervals' Jacobians side by side, then the linear rows', permuted into column order.
    node_jacobian, running_gradient = interval.node_jacobian.map(m * n)(xi, theta)
    values = interval.chain_jacobian.map(n)(w, share, node_jacobian)
    rows, columns = interval.jacobian_pattern
    extra = sp.coo_matrix(linear)
    global_rows = (rows[None, :] + interval.n_rows * np.arange(n)[:, None]).ravel()
    global_rows = np.concatenate([global_rows, extra.row + n * interval.n_rows])
    global_columns = np.concatenate([gather[:, columns].ravel(), extra.col])
    n_rows = n * interval.n_rows + linear.shape[0]
    nonzeros = ca.vertcat(ca.vec(values), ca.DM(extra.data))
    jacobian = _assemble(nonzeros, global_rows, global_columns, (n_rows, layout.size))

    gradients = interval.chain_gradient.map(n)(w, share, node_rows[n_f, :], running_gradient)
    gradient = _scatter(gather.ravel(), layout.size) @ ca.vec(gradients) + c

    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", n_rows)
    lam = ca.reshape(lam_g[: n * interval.n_rows], interval.n_rows, n)
    lam_nodes = ca.reshape(lam[interval.n_own :, :], n_f, m * n)
    lam_running = ca.reshape(lam_f * ca.DM(interval.weights) @ h, 1, m * n)
    node_gradient, node_hessian = interval.node_hessian.map(m * n)(xi, theta, ca.vertcat(lam_nodes, lam_running))
    hess_values = interval.chain_hessian.map(n)(
        w,
        share,
        lam[: interval.n_own, :],
        ca.repmat(lam_f, 1, n),
        node_gradient,
        node_hessian,
        running_gradient,
    )
    rows, columns = interval.hessian_pattern
    first, second = gather[:, rows].ravel(), gather[:, columns].ravel()
    shape = (layout.size, layout.size)
    hessian = _assemble(ca.vec(hess_values), np.minimum(first, second), np.maximum(first, second), shape)
    signature = ["x", "p", "lam_f", "lam_g"]
    functions = {
        "nlp": ca.Function("nlp", [x, p], [f, g], ["x", "p"], ["f", "g"]),
        "grad_f": ca.Function("nlp_grad_f", [x, p], [f, gradient], ["x", "p"], ["f", "grad_f_x"]),
        "jac_g": ca.Function("nlp_jac_g", [x, p], [g, jacobian], ["x", "p"], ["g", "jac_g_x"]),
        "hess_lag": ca.Function("nlp_hess_l", [x, p, lam_f, lam_g], [hessian], signature, ["triu_hess_gamma_x_x"]),
    }
    return Program(layout=layout, interval=interval, mesh=mesh, functions=functions, n_rows=n_rows, linear=linear)


def _gather(layout: Layout, mesh: Mesh) -> np.ndarray:
    n = layout.n_intervals
    block = np.arange(n)[:, None] * layout.block + np.arange(layout.block + layout.n_state)
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
