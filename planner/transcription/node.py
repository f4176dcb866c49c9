"""One node of a transcription: the system's rows and running cost at an instant, with their derivatives.

These are the expensive functions, and they know neither scheme nor mesh: taken once, they serve every transcription of a
system. Nonzeros are dense columns; where they stand is said beside them.
"""

from dataclasses import dataclass, fields

import casadi as ca
import numpy as np

from linkplan.planner.transcription.system import System

# Operations of a node from which on it is shared before it is differentiated, and of a function beyond which what they have
# in common is not looked for: a platform on six legs with 3.4 million gained a thousandth by that, in 150 s.
_LONG, _SHARED = 20_000, 1_000_000
Pattern = tuple[np.ndarray, np.ndarray]  # rows and columns of nonzeros, column by column
_NOTHING: Pattern = (np.zeros(0, dtype=int), np.zeros(0, dtype=int))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class NodeFunctions:
    """CasADi functions of one node (xi, theta), and of an end at which none stands.

    `node_value` gives the rows (n_f,), `node_jacobian` the nonzeros of their Jacobian, `node_cost` the running cost and
    `node_cost_gradient` its gradient; `node_hessian` (xi, theta, lambda of rows and cost) a gradient and the nonzeros of an
    upper triangle. `open_end_value`, `open_end_jacobian` and `open_end_hessian` are the same of the rows that are imposed
    where no node stands, `open_end_rows` of a node's, without a cost; None where none are. `open_end_z` are the algebraic
    unknowns that those need.
    """

    node_value: ca.Function
    node_jacobian: ca.Function
    node_cost: ca.Function
    node_cost_gradient: ca.Function
    node_hessian: ca.Function
    open_end_value: ca.Function | None = None
    open_end_jacobian: ca.Function | None = None
    open_end_hessian: ca.Function | None = None
    jacobian_pattern: Pattern
    hessian_pattern: Pattern
    open_end_jacobian_pattern: Pattern = _NOTHING
    open_end_hessian_pattern: Pattern = _NOTHING
    open_end_rows: tuple[int, ...] = ()
    open_end_z: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        as_kept(self)


def as_kept(functions: object) -> None:
    """Make patterns and tuples of what may come as lists from a record of the cache."""
    for field in fields(functions):
        value = getattr(functions, field.name)
        if field.name.endswith("pattern"):
            object.__setattr__(functions, field.name, tuple(np.array(part, dtype=int) for part in value))
        elif isinstance(value, list):
            object.__setattr__(functions, field.name, tuple(value))


def build_node(system: System, open_end_path: tuple[int, ...] = ()) -> NodeFunctions:
    """Return the functions of a node of a system; path quantities of `open_end_path` are rows at open ends too."""
    functions, patterns = _functions(system, "node", system.node, system.n_equations + system.n_path)
    xi, theta = ca.SX.sym("xi", system.n_xi), ca.SX.sym("theta", system.n_theta)
    cost = ca.densify(system.node(xi, theta))[system.n_equations + system.n_path]
    functions["node_cost"] = _function("node_cost", [xi, theta], [cost])
    functions["node_cost_gradient"] = _function("node_cost_gradient", [xi, theta], [ca.densify(ca.gradient(cost, xi))])
    rows, z = (), ()
    if open_end_path:
        rows = _open_end_rows(system, open_end_path)
        at = _at_open_ends(system, rows)
        of_ends, their_patterns = _functions(system, "open_end", at, len(rows))
        functions, z = functions | of_ends, _open_end_z(system, at)
        patterns |= {f"open_end_{name}": pattern for name, pattern in their_patterns.items()}
    return NodeFunctions(**functions, **patterns, open_end_rows=rows, open_end_z=z)


def _functions(system: System, name: str, at: ca.Function, n_f: int) -> tuple[dict[str, ca.Function], dict[str, Pattern]]:
    """Return the value, Jacobian and Hessian functions of rows (n_f,) and a cost, and the latter two's patterns."""
    xi, theta = ca.SX.sym("xi", system.n_xi), ca.SX.sym("theta", system.n_theta)
    F = ca.densify(at(xi, theta))
    if ca.n_nodes(F) > _LONG:  # shared before it is differentiated: a third less to differentiate
        F = ca.cse(F)
    jacobian = ca.jacobian(F[:n_f], xi)
    lam = ca.SX.sym("lam", F.numel())
    hessian, gradient = ca.hessian(ca.dot(lam, F), xi)
    hessian = ca.triu(hessian)
    functions = {
        f"{name}_value": _function(f"{name}_value", [xi, theta], [F[:n_f]]),
        f"{name}_jacobian": _function(f"{name}_jacobian", [xi, theta], [nonzeros(jacobian)]),
        f"{name}_hessian": _function(f"{name}_hessian", [xi, theta, lam], [ca.densify(gradient), nonzeros(hessian)]),
    }
    return functions, {"jacobian_pattern": triplets(jacobian), "hessian_pattern": triplets(hessian)}


def _function(name: str, inputs: list, outputs: list) -> ca.Function:
    shared = ca.n_nodes(ca.veccat(*outputs)) <= _SHARED
    return ca.Function(name, inputs, outputs, {"cse": shared})


def _open_end_rows(system: System, open_end_path: tuple[int, ...]) -> tuple[int, ...]:
    """Return the rows of a node that hold where none stands: closure, and the path quantities that are bounded there."""
    closure = tuple(i for i in range(system.n_equations) if system.kinds[i] == "closure")
    return closure + tuple(system.n_equations + i for i in open_end_path)


def _at_open_ends(system: System, open_end_rows: tuple[int, ...]) -> ca.Function:
    """Return a node's function with those rows alone, and a cost of zero."""
    xi, theta = ca.SX.sym("xi", system.n_xi), ca.SX.sym("theta", system.n_theta)
    return ca.Function("open_end", [xi, theta], [ca.vertcat(system.node(xi, theta)[list(open_end_rows)], 0)])


def _open_end_z(system: System, at_open_ends: ca.Function) -> tuple[int, ...]:
    """Return the algebraic unknowns on which a function of a node depends."""
    first = system.n_xi - system.n_u - system.n_z
    columns = np.unique(np.array(at_open_ends.jac_sparsity(0, 0).get_triplet()[1], dtype=int)) - first
    return tuple(int(i) for i in columns if 0 <= i < system.n_z)


def nonzeros(matrix: ca.SX) -> ca.SX:
    """Return a matrix's nonzeros as a column (CasADi gives a row for a row)."""
    return ca.vec(matrix.nz[:])


def triplets(matrix: ca.SX) -> Pattern:
    """Return the rows and columns of a matrix's nonzeros."""
    rows, columns = matrix.sparsity().get_triplet()
    return np.array(rows, dtype=int), np.array(columns, dtype=int)
