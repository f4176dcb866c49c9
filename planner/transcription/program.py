"""The nonlinear program over a mesh: the functions of one interval, mapped over all intervals and placed by index.

The unknowns are, interval by interval, the left state, nodal accelerations, nodal dependent positions z (with rows
phi(s, z) = 0) and the effort's Bernstein coefficients; then the last state, the segments' durations, and extra unknowns.
Derivatives of one node and one interval are taken once, symbolically, and mapped. A permutation puts their nonzeros into
place, so building takes the same time for 10 intervals as for 1,000 and needs no graph colouring. Rows that are linear in
the unknowns (periodicity, total duration) are appended.

The compiled functions are small (one node, one interval) and serve a mesh of any size. They form two libraries. The node's
functions depend only on the structure of the mechanism and the objective, not on their numbers or the transcription: masses,
lengths and other constants of a node's expressions become parameters of the node (`without_numbers`). The chain rule's
functions depend on the transcription and the sizes alone. One compilation of half a second therefore serves every later
solve of mechanisms of one structure, whatever their lengths and masses (every four-bar of a design study). A cached library
is found before derivatives are built, because the key hashes only the node's expressions or the sizes.
"""

import functools
import hashlib
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path

import casadi as ca
import numpy as np

from linkplan.models.compiled.functions import over_columns, tools_hash
from linkplan.planner.transcription.interval import IntervalFunctions, IntervalRows, open_end_path
from linkplan.planner.transcription.mesh import Layout, Mesh, Triplets, pattern, scatter
from linkplan.planner.transcription.schemes import Scheme
from linkplan.planner.transcription.system import Endpoint, NodeFunctions, System

# Only constants that are summands, factors or divisors become parameters. Exponents and compared constants determine the
# form of the derivatives and stay.
_REPLACED_OPERATIONS = (ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV)
# Constants of the equations, not of the model. A model's number that equals one of them except for rounding counts as
# equal: an entry of a rotation may be 1 in one mechanism and 1 - 1e-16 in the next.
_EQUATION_CONSTANTS = np.array([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0])


@functools.lru_cache(maxsize=32)
def without_numbers(system: System) -> tuple[System, np.ndarray]:
    """Return a system with its node's constants as further parameters, and the values (n,) of these parameters.

    A system of first order is returned unchanged, because it is one problem and not a family. So is a system whose
    expressions call functions.
    """
    node = system.node
    if not system.n_s or not node.is_a("SXFunction") or ca.OP_CALL in map(node.instruction_id, range(node.n_instructions())):
        return system, np.zeros(0)
    xi, theta = ca.SX.sym("xi", node.size1_in(0)), ca.SX.sym("theta", system.n_theta)
    given = (ca.vertsplit(xi), ca.vertsplit(theta))
    taken = _taken(node)
    symbols = ca.SX.sym("numbers", len(taken))
    name = dict(zip(taken, ca.vertsplit(symbols) if taken else [], strict=True))
    work: list[ca.SX] = [ca.SX(0)] * node.sz_w()
    column = ca.SX(node.sparsity_out(0))
    values: list = [ca.SX(0)] * column.nnz()
    for k in range(node.n_instructions()):
        op, out, into = node.instruction_id(k), node.instruction_output(k), node.instruction_input(k)
        if op == ca.OP_OUTPUT:
            values[out[1]] = work[into[0]]
        elif op == ca.OP_INPUT:
            work[out[0]] = given[into[0]][into[1]]
        elif op == ca.OP_CONST:
            work[out[0]] = name[k] if k in name else ca.SX(_rounded(node.instruction_constant(k)))
        elif len(into) == 1:
            work[out[0]] = ca.SX.unary(op, work[into[0]])
        else:
            work[out[0]] = ca.SX.binary(op, work[into[0]], work[into[1]])
    column = ca.SX(node.sparsity_out(0), ca.vertcat(*values))
    numbers = np.array([node.instruction_constant(k) for k in taken])
    return replace(system, node=ca.Function("node", [xi, ca.vertcat(theta, symbols)], [column])), numbers


def _taken(node: ca.Function) -> list[int]:
    """Return the indices of the instructions that load a model's numbers."""
    standing: dict[int, int] = {}  # the instruction whose constant a place of the work vector holds
    kept: set[int] = set()
    taken = []
    for k in range(node.n_instructions()):
        op, out = node.instruction_id(k), node.instruction_output(k)
        if op != ca.OP_INPUT and op not in _REPLACED_OPERATIONS:
            kept |= {standing[place] for place in node.instruction_input(k) if place in standing}
        if op == ca.OP_OUTPUT:
            continue
        standing.pop(out[0], None)
        if op == ca.OP_CONST and _is_model_number(node.instruction_constant(k)):
            standing[out[0]] = k
            taken.append(k)
    return [k for k in taken if k not in kept]


def _rounded(constant: float) -> float:
    """Return a constant, replaced by the constant of the equations that it equals except for rounding."""
    nearest = float(_EQUATION_CONSTANTS[np.argmin(np.abs(_EQUATION_CONSTANTS - constant))])
    return nearest if abs(nearest - constant) <= 4e-16 * abs(nearest) else constant


def _is_model_number(constant: float) -> bool:
    """Check that a constant is finite and no constant of the equations."""
    return bool(np.isfinite(constant)) and _rounded(constant) not in _EQUATION_CONSTANTS


@functools.lru_cache(maxsize=32)
def node_key(system: System, at_open_ends: tuple[int, ...] = ()) -> str:
    """Return the cache key of a node's functions: a hash of its expressions and of the tools that compile them."""
    digest = hashlib.sha256(tools_hash(Path(__file__).parent))
    digest.update(system.node.serialize().encode())
    digest.update(repr(("node", *_sizes(system), system.n_theta, system.kinds, at_open_ends)).encode())
    return f"k{digest.hexdigest()[:32]}"  # begins with a letter, because CasADi makes an identifier of it


def chain_key(system: System, scheme: Scheme, rows: IntervalRows, node: NodeFunctions) -> str:
    """Return the cache key of the chain rule's functions: a hash of sizes, patterns and constants, without expressions."""
    digest = hashlib.sha256(tools_hash(Path(__file__).parent))
    digest.update(repr(("chain", *_sizes(system), rows, open_end_path(scheme, rows))).encode())
    digest.update(repr((node.open_end_rows, node.open_end_z, scheme.name, scheme.effort_at.tolist())).encode())
    for field in fields(NodeFunctions):
        if field.name.endswith("pattern"):
            digest.update(repr([part.tolist() for part in getattr(node, field.name)]).encode())
    return f"k{digest.hexdigest()[:32]}"


def _sizes(system: System) -> tuple[int, ...]:
    sizes = system.n_s, system.n_x, system.n_z, system.n_u, system.n_equations, system.n_path
    return *sizes, system.has_jerk, *system.eliminated


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Program:
    """A nonlinear program: CasADi functions of all unknowns x and parameters p, ready for a solver.

    Parameters are, per interval, its share of the segment, its own parameters and those of its nodes; then the endpoint's.
    """

    layout: Layout
    interval: IntervalFunctions
    mesh: Mesh
    functions: dict[str, ca.Function]  # "nlp", "grad_f", "jac_g"
    hess_lag: Callable[[], ca.Function]  # builds the Hessian of the Lagrangian at the first call; corrections need none
    n_rows: int
    linear: Triplets

    @property
    def n_s(self) -> int:
        """The number of second-order coordinates."""
        return self.layout.n_s

    @property
    def n_u(self) -> int:
        """The number of efforts."""
        return self.layout.n_u

    @property
    def n_intervals(self) -> int:
        """The number of intervals."""
        return self.mesh.n_intervals


def build_program(
    layout: Layout,
    mesh: Mesh,
    interval: IntervalFunctions,
    linear: Triplets,
    cost: np.ndarray,
    endpoint: Endpoint | None = None,
) -> Program:
    """Return the program over a mesh.

    Args:
        layout: where the unknowns stand.
        mesh: intervals and segments.
        interval: from `interval_of`.
        linear: appended rows (n_linear, n) that are linear in the unknowns.
        cost: gradient (n,) of the objective's linear part.
        endpoint: rows, appended last, and cost of the motion's ends.
    """
    n, m, n_f = mesh.n_intervals, interval.n_nodes, interval.n_equations + interval.n_path
    node, chain = interval.node, interval.chain
    n_xi, n_theta = node.node_value.size1_in(0), node.node_value.size1_in(1)
    n_eta = chain.own.size1_in(2)
    at_nodes = functools.partial(over_columns, lanes=node.lanes, n=m * n)
    at_intervals = functools.partial(over_columns, lanes=chain.lanes, n=n)
    places = gather(layout, mesh)  # (n, n_w) index of each interval's unknowns
    n_open_ends = interval.n_open_ends
    size = (1 + n_eta + (m + n_open_ends) * n_theta) * n
    x, p = ca.MX.sym("x", layout.size), ca.MX.sym("p", size + (endpoint.n_parameters if endpoint else 0))
    w = ca.reshape(x[places.ravel().tolist()], places.shape[1], n)
    P = ca.reshape(p[:size], size // n, n)
    share, eta, theta = P[0, :], P[1 : 1 + n_eta, :], P[1 + n_eta :, :]
    ends = _Ends(endpoint, layout, x, p[size:]) if endpoint else None
    A, c = linear.dm(), ca.DM(cost)
    points = ca.reshape(at_intervals(chain.nodes)(w, share), (m + n_open_ends) * n_xi, n)
    xi, theta_nodes = ca.reshape(points[: m * n_xi, :], n_xi, m * n), ca.reshape(theta[: m * n_theta, :], n_theta, m * n)
    open_ends = _OpenEnds(interval, points[m * n_xi :, :], theta[m * n_theta :, :])

    own_rows, own_costs = at_intervals(chain.own)(w, share, eta)
    g_nodes = ca.reshape(at_nodes(node.node_value)(xi, theta_nodes), m * n_f, n)
    g = ca.vertcat(ca.vec(ca.vertcat(own_rows, g_nodes, open_ends.rows)), A @ x, *([ends.rows] if ends else []))
    costs = at_nodes(node.node_cost)(xi, theta_nodes)
    running = ca.reshape(costs, m, n)
    h = share * x[layout.durations()[mesh.segment].tolist()].T
    f = ca.sum2(own_costs) + ca.dot(h, ca.DM(interval.weights).T @ running) + ca.dot(c, x) + (ends.cost if ends else 0)

    # CasADi's map distributes columns in order: nodes k m to (k + 1) m - 1 belong to interval k.
    # Jacobian: the intervals' nonzeros, then the linear rows' nonzeros, permuted into column order.
    node_jacobian = at_nodes(node.node_jacobian)(xi, theta_nodes)
    values = at_intervals(chain.chain_jacobian)(w, share, eta, node_jacobian, open_ends.jacobian)
    rows, columns = chain.jacobian_pattern
    global_rows = (rows[None, :] + interval.n_rows * np.arange(n)[:, None]).ravel()
    global_rows = np.concatenate([global_rows, linear.rows + n * interval.n_rows])
    global_columns = np.concatenate([places[:, columns].ravel(), linear.columns])
    n_rows = n * interval.n_rows + linear.shape[0]
    nonzeros = ca.vertcat(ca.vec(values), ca.DM(linear.values))
    if ends:
        nonzeros = ca.vertcat(nonzeros, ends.jacobian)
        global_rows = np.concatenate([global_rows, n_rows + ends.jacobian_places[0]])
        global_columns = np.concatenate([global_columns, ends.jacobian_places[1]])
        n_rows += endpoint.n_rows
    jacobian = _assemble(nonzeros, global_rows, global_columns, (n_rows, layout.size))

    running_gradient = at_nodes(node.node_cost_gradient)(xi, theta_nodes)
    gradients = at_intervals(chain.chain_gradient)(w, share, eta, costs, running_gradient)
    gradient = scatter(places.ravel(), layout.size) @ ca.vec(gradients) + c
    if ends:
        gradient += scatter(ends.gradient_places, layout.size) @ ends.gradient

    @functools.cache
    def hess_lag() -> ca.Function:
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", n_rows)
        lam = ca.reshape(lam_g[: n * interval.n_rows], interval.n_rows, n)
        first_open_end = interval.n_own + m * n_f
        lam_nodes = ca.reshape(lam[interval.n_own : first_open_end, :], n_f, m * n)
        lam_running = ca.reshape(lam_f * ca.DM(interval.weights) @ h, 1, m * n)
        node_gradient, node_hessian = at_nodes(node.node_hessian)(xi, theta_nodes, ca.vertcat(lam_nodes, lam_running))
        open_end_gradient, open_end_hessian = open_ends.hessian(lam[first_open_end:, :])
        gradients_at = ca.vertcat(ca.reshape(node_gradient, n_xi * m, n), open_end_gradient)
        hess_values = at_intervals(chain.chain_hessian)(
            w,
            share,
            eta,
            lam[: interval.n_own, :],
            ca.repmat(lam_f, 1, n),
            ca.reshape(gradients_at, n_xi, (m + n_open_ends) * n),
            node_hessian,
            open_end_hessian,
            running_gradient,
        )
        rows, columns = chain.hessian_pattern
        first, second = places[:, rows].ravel(), places[:, columns].ravel()
        shape = (layout.size, layout.size)
        hess_values = ca.vec(hess_values)
        if ends:
            hess_values = ca.vertcat(hess_values, ends.hessian(lam_f, lam_g[n_rows - endpoint.n_rows :]))
            first = np.concatenate([first, ends.hessian_places[0]])
            second = np.concatenate([second, ends.hessian_places[1]])
        hessian = _assemble(hess_values, np.minimum(first, second), np.maximum(first, second), shape)
        return hessian_function(x, p, lam_f, lam_g, hessian)

    functions = program_functions(x, p, f, g, gradient, jacobian)
    return Program(
        layout=layout, interval=interval, mesh=mesh, functions=functions, hess_lag=hess_lag, n_rows=n_rows, linear=linear
    )


def program_functions(x: ca.MX, p: ca.MX, f: ca.MX, g: ca.MX, gradient: ca.MX, jacobian: ca.MX) -> dict[str, ca.Function]:
    """Return a program's functions of x and p with the names that CasADi's solvers expect."""
    return {
        "nlp": ca.Function("nlp", [x, p], [f, g], ["x", "p"], ["f", "g"]),
        "grad_f": ca.Function("nlp_grad_f", [x, p], [f, gradient], ["x", "p"], ["f", "grad_f_x"]),
        "jac_g": ca.Function("nlp_jac_g", [x, p], [g, jacobian], ["x", "p"], ["g", "jac_g_x"]),
    }


def hessian_function(x: ca.MX, p: ca.MX, lam_f: ca.MX, lam_g: ca.MX, hessian: ca.MX) -> ca.Function:
    """Return the upper triangle of the Hessian of lam_f f + lam_g g as CasADi's solvers expect it."""
    signature = ["x", "p", "lam_f", "lam_g"]
    return ca.Function("nlp_hess_l", [x, p, lam_f, lam_g], [hessian], signature, ["triu_hess_gamma_x_x"])


class _OpenEnds:
    """Rows at open ends and their derivatives' values; empty if nothing is bounded there.

    `points` and `theta` are the columns (n_open_ends * n_xi, n) and (n_open_ends * n_theta, n) of n intervals.
    """

    def __init__(self, interval: IntervalFunctions, points: ca.MX, theta: ca.MX) -> None:
        self._interval, self._n, self._count = interval, points.shape[1], interval.n_open_ends * points.shape[1]
        self.rows, self.jacobian = ca.MX(0, self._n), ca.MX(0, 0)
        if interval.n_open_ends:
            n_xi, n_theta = (points.shape[0] // interval.n_open_ends, theta.shape[0] // interval.n_open_ends)
            self._at = ca.reshape(points, n_xi, self._count), ca.reshape(theta, n_theta, self._count)
            rows = self._over("value")(*self._at)
            self.rows = ca.reshape(rows, interval.n_open_ends * len(interval.open_end_rows), self._n)
            self.jacobian = self._over("jacobian")(*self._at)

    def _over(self, name: str) -> Callable:
        node = self._interval.node
        return over_columns(getattr(node, f"open_end_{name}"), node.lanes, self._count)

    def hessian(self, lam: ca.MX) -> tuple[ca.MX, ca.MX]:
        """Return gradients (n_open_ends * n_xi, n) and the Hessians' values for multipliers (n_open_ends * n_rows, n)."""
        if not self._interval.n_open_ends:
            return ca.MX(0, self._n), ca.MX(0, 0)
        lam = ca.vertcat(ca.reshape(lam, len(self._interval.open_end_rows), self._count), ca.MX.zeros(1, self._count))
        gradient, hessian = self._over("hessian")(*self._at, lam)
        return ca.reshape(gradient, gradient.shape[0] * self._interval.n_open_ends, self._n), hessian


class _Ends:
    """The endpoint's rows and cost with their derivatives, and their places in the whole program.

    The local unknowns are e = [first state; last state; algebraic unknowns of the last node and last efforts, if needed by
    the endpoint; duration], where the duration is the sum of the segments' durations.
    """

    def __init__(self, endpoint: Endpoint, layout: Layout, x: ca.MX, parameters: ca.MX) -> None:
        ends, effort = (layout.state(0), layout.state(layout.n_intervals)), layout.effort()[-1, -1]
        places = endpoint.unknowns(*ends, layout.dependent()[-1, -1], effort)
        size = len(places) + 1
        e, q = ca.SX.sym("e", size), ca.SX.sym("q", endpoint.n_parameters)
        F = endpoint.at(e[: size - 1], e[size - 1], q, layout.n_state)
        # CasADi makes a row of an empty slice of a column.
        rows, cost = ca.reshape(F[: endpoint.n_rows], endpoint.n_rows, 1), F[endpoint.n_rows]
        at = ca.vertcat(x[[int(i) for i in places]], ca.sum1(x[layout.durations().tolist()]))
        # Each local unknown has one place, except the duration, which has one place per segment.
        self._where = [np.array([i]) for i in places] + [layout.durations()]
        value = ca.Function("ends", [e, q], [rows, cost])(at, parameters)
        self.rows, self.cost = value
        J, dense = ca.jacobian(rows, e), ca.densify(ca.gradient(cost, e))
        row, column, order = self._spread(*J.sparsity().get_triplet(), second_is_place=True)
        self.jacobian_places = row, column
        self.jacobian = ca.Function("ends_jacobian", [e, q], [_column(J.nz[:])])(at, parameters)[order]
        everything = list(range(size))
        _, self.gradient_places, order = self._spread([0] * len(everything), everything, second_is_place=True)
        self.gradient = ca.Function("ends_gradient", [e, q], [dense])(at, parameters)[order]
        lam = ca.SX.sym("lam", 1 + endpoint.n_rows)
        H = ca.hessian(lam[0] * cost + ca.dot(_column(lam[1:]), rows), e)[0]
        i, j = H.sparsity().get_triplet()
        first, second, order = self._spread(i, j, second_is_place=False)
        upper = first <= second
        self.hessian_places = first[upper], second[upper]
        chosen = [value for value, kept in zip(order, upper, strict=True) if kept]
        self._hessian = ca.Function("ends_hessian", [e, q, lam], [_column(_column(H.nz[:])[chosen])])
        self._at = at, parameters

    def hessian(self, lam_f: ca.MX, lam_rows: ca.MX) -> ca.MX:
        """Return the Hessian's values at `hessian_places`."""
        return self._hessian(*self._at, ca.vertcat(lam_f, lam_rows))

    def _spread(self, rows, columns, *, second_is_place: bool):
        """Return triplets with local unknowns replaced by their places, and the index of the value at each."""
        first, second, order = [], [], []
        for value, (i, j) in enumerate(zip(rows, columns, strict=True)):
            for a in [i] if second_is_place else self._where[i]:
                for b in self._where[j]:
                    first.append(int(a))
                    second.append(int(b))
                    order.append(value)
        return np.array(first, dtype=int), np.array(second, dtype=int), order


def _column(values: ca.SX) -> ca.SX:
    return ca.reshape(values, values.numel(), 1)


def gather(layout: Layout, mesh: Mesh) -> np.ndarray:
    """Return the indices (n, n_w) of each interval's unknowns."""
    n = layout.n_intervals
    block = np.arange(n)[:, None] * layout.block + np.arange(layout.block + layout.n_state)
    return np.hstack([block, layout.durations()[mesh.segment][:, None]])


def _assemble(values: ca.MX, rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]) -> ca.MX:
    """Return the sparse matrix of triplets; values at equal places are added."""
    key = columns * shape[0] + rows
    places, inverse = np.unique(key, return_inverse=True)
    sparsity = pattern(places % shape[0], places // shape[0], shape)
    if len(places) == len(key):
        order = np.empty(len(key), dtype=int)
        order[inverse] = np.arange(len(key))
        return ca.MX(sparsity, values[order.tolist()])
    return ca.MX(sparsity, scatter(inverse, len(places)) @ values)
