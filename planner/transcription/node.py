"""One node of a transcription: the system's rows and running cost at an instant, with their derivatives.

These are the expensive functions. They depend on neither scheme nor mesh, so every transcription of a system uses the same.
Sparse matrices are columns of nonzeros, each with its pattern.
"""

from dataclasses import dataclass, fields
from typing import Any

import casadi as ca
import numpy as np

from linkplan.planner.transcription.system import System

# Common subexpressions of a node with more operations than this are eliminated before differentiation.
_MAX_UNSHARED_OPERATIONS = 20_000
# In functions with more operations they are not sought: with 3.4 million (a platform on six legs) this took 150 s and saved
# 0.1 %.
_MAX_SHARED_OPERATIONS = 1_000_000
Pattern = tuple[np.ndarray, np.ndarray]  # rows and columns of nonzeros, column by column
_EMPTY_PATTERN: Pattern = (np.zeros(0, dtype=int), np.zeros(0, dtype=int))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class NodeFunctions:
    """CasADi functions of one node (xi, theta), and of an open end, where no node lies.

    `node_value` gives the rows (n_f,), `node_jacobian` the nonzeros of their Jacobian, `node_cost` the running cost and
    `node_cost_gradient` its gradient. `node_hessian` (xi, theta, multipliers of rows and cost) gives a gradient and the
    nonzeros of an upper triangle. `open_end_value`, `open_end_jacobian` and `open_end_hessian` are the same functions for
    the rows at open ends, without a cost; None if there are no such rows. `open_end_rows` are the indices of these rows
    among a node's rows, `open_end_z` the algebraic unknowns in them.
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
    open_end_jacobian_pattern: Pattern = _EMPTY_PATTERN
    open_end_hessian_pattern: Pattern = _EMPTY_PATTERN
    open_end_rows: tuple[int, ...] = ()
    open_end_z: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        convert_lists(self)


def convert_lists(functions: Any) -> None:
    """Convert the lists of a cache record to patterns and tuples, in place during construction."""
    for field in fields(functions):
        value = getattr(functions, field.name)
        if field.name.endswith("pattern"):
            object.__setattr__(functions, field.name, tuple(np.array(part, dtype=int) for part in value))
        elif isinstance(value, list):
            object.__setattr__(functions, field.name, tuple(value))


def build_node(system: System, open_end_path: tuple[int, ...] = ()) -> NodeFunctions:
    """Return a system's node functions; the path quantities in `open_end_path` are rows at open ends too."""
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


def _functions(system: System, name: str, at: ca.Function, n_f: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the value, Jacobian and Hessian functions of rows (n_f,) and a cost, with the patterns of the latter two."""
    xi, theta = ca.SX.sym("xi", system.n_xi), ca.SX.sym("theta", system.n_theta)
    F = ca.densify(at(xi, theta))
    if ca.n_nodes(F) > _MAX_UNSHARED_OPERATIONS:  # leaves a third less to differentiate
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
    shared = ca.n_nodes(ca.veccat(*outputs)) <= _MAX_SHARED_OPERATIONS
    return ca.Function(name, inputs, outputs, {"cse": shared})


def _open_end_rows(system: System, open_end_path: tuple[int, ...]) -> tuple[int, ...]:
    """Return the rows of a node that are imposed at open ends: closure, and the given path quantities."""
    closure = tuple(i for i in range(system.n_equations) if system.kinds[i] == "closure")
    return closure + tuple(system.n_equations + i for i in open_end_path)


def _at_open_ends(system: System, open_end_rows: tuple[int, ...]) -> ca.Function:
    """Return a node's function with only these rows, and a cost of zero."""
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
