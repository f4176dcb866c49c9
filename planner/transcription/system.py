"""A continuous problem at one instant: equations, bounded quantities and running cost, with their derivatives at a node.

A node is (s, v, a, j, x, r, z, u): positions, velocities and accelerations of second-order coordinates, the accelerations'
rates j (jerks) where a system takes them, states x of first-order equations with their rates r, algebraic unknowns z,
efforts u. A system is independent of meshes and knows no mechanisms. The functions of a node are the expensive ones. They
depend on neither scheme nor mesh, so every transcription of a system uses the same. Sparse matrices are columns of nonzeros,
each with its pattern.
"""

from dataclasses import dataclass, fields
from typing import Any

import casadi as ca
import numpy as np

from linkplan.planner.transcription.implicit import Implicit

# Common subexpressions are eliminated from a node's rows, and from derivatives with at most this number of operations.
# For longer derivatives the elimination would take two thirds of the building time and remove 4 to 14 % of the operations.
_MAX_SHARED_OPERATIONS = 20_000
Pattern = tuple[np.ndarray, np.ndarray]  # rows and columns of nonzeros, column by column
_EMPTY_PATTERN: Pattern = (np.zeros(0, dtype=int), np.zeros(0, dtype=int))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class System:
    """Equations, bounded quantities and running cost at a node, all scaled to order one.

    `node` maps (xi, theta) to a column [equations (n_equations,); path quantities (n_path,); running cost], where xi
    (n_xi,) stacks a node's scaled unknowns and theta (n_theta,) its parameters. `eliminated` are the sizes of blocks of
    further unknowns y, which equations of the node determine (see `Implicit`). `node` then maps ([xi; y], theta), and these
    equations come last in its column.
    """

    n_s: int = 0
    n_x: int
    n_z: int = 0
    n_u: int
    node: ca.Function
    n_equations: int
    n_path: int
    kinds: tuple[str, ...]  # of each equation and path quantity; "path": as far as known no effort changes its rate at once
    has_jerk: bool = False  # whether a node's unknowns include the rates of its accelerations
    eliminated: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if len(self.kinds) != self.n_equations + self.n_path:
            raise ValueError(f"system has {self.n_equations} + {self.n_path} rows, {len(self.kinds)} kinds")

    @property
    def n_xi(self) -> int:
        """The number of a node's unknowns."""
        return (4 if self.has_jerk else 3) * self.n_s + 2 * self.n_x + self.n_z + self.n_u

    @property
    def n_theta(self) -> int:
        """The number of a node's parameters."""
        return int(self.node.size1_in(1))

    @property
    def n_state(self) -> int:
        """The number of states that adjacent intervals share: s, v and x."""
        return 2 * self.n_s + self.n_x


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class NodeSymbols:
    """A node's unknowns as symbols, and the column that stacks them."""

    s: ca.SX
    v: ca.SX
    a: ca.SX
    j: ca.SX
    x: ca.SX
    r: ca.SX
    z: ca.SX
    u: ca.SX

    @property
    def stacked(self) -> ca.SX:
        """The unknowns in the order of xi."""
        return ca.vertcat(self.s, self.v, self.a, self.j, self.x, self.r, self.z, self.u)


def node_symbols(n_s: int, n_x: int, n_z: int, n_u: int, *, has_jerk: bool = False) -> NodeSymbols:
    """Return fresh symbols for a node's unknowns."""
    sizes = {"s": n_s, "v": n_s, "a": n_s, "j": n_s if has_jerk else 0, "x": n_x, "r": n_x, "z": n_z, "u": n_u}
    return NodeSymbols(**{name: ca.SX.sym(name, size) for name, size in sizes.items()})


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Endpoint:
    """Rows and a cost that depend on both ends of a motion.

    `function` maps (first state, last state, duration, parameters), all scaled, to a column [rows (n_rows,); cost]. If
    `algebraic`, its next input is the algebraic unknowns (n_z,) of the last node, which must then lie at the end. If
    `effort`, its last input is the efforts (n_u,) at the end.
    """

    function: ca.Function
    n_rows: int
    algebraic: bool = False
    effort: bool = False

    @property
    def n_parameters(self) -> int:
        """The number of parameters."""
        return int(self.function.size1_in(3))

    def unknowns(self, first: Any, last: Any, z: Any, u: Any) -> list:
        """Return the unknowns except the duration in one list: first state, last state, and those asked for of z and u."""
        return [*first, *last, *(z if self.algebraic else ()), *(u if self.effort else ())]

    def at(self, e: ca.SX, duration: ca.SX, parameters: ca.SX, n_state: int) -> ca.SX:
        """Return [rows; cost] at the unknowns e, in the order of `unknowns`."""
        further, first = [], 2 * n_state
        for k in range(4, self.function.n_in()):
            further.append(e[first : first + self.function.size1_in(k)])
            first += self.function.size1_in(k)
        return ca.densify(self.function(e[:n_state], e[n_state : 2 * n_state], duration, parameters, *further))


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
    lanes: int = 1  # the samples of one call, side by side

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
    n_f = system.n_equations + system.n_path
    functions, patterns = _functions(system, "node", list(range(n_f + 1)))
    rows, z = (), ()
    if open_end_path:
        rows = _open_end_rows(system, open_end_path)
        of_ends, their_patterns = _functions(system, "open_end", list(rows))
        functions |= of_ends
        patterns |= {f"open_end_{name}": pattern for name, pattern in their_patterns.items()}
        first = system.n_xi - system.n_u - system.n_z
        columns = np.unique(their_patterns["jacobian_pattern"][1]) - first
        z = tuple(int(i) for i in columns if 0 <= i < system.n_z)
    return NodeFunctions(**functions, **patterns, open_end_rows=rows, open_end_z=z)


def _functions(system: System, name: str, rows: list[int]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the value, Jacobian and Hessian functions of some rows, with the patterns of the latter two.

    If the last one is the running cost, there are also its value and gradient, and the rows end before it.
    """
    n_rows = system.n_equations + system.n_path
    xi, theta = ca.SX.sym("xi", system.n_xi), ca.SX.sym("theta", system.n_theta)
    y = ca.SX.sym("y", sum(system.eliminated))
    column = ca.cse(ca.densify(system.node(ca.vertcat(xi, y), theta)))
    implicit = Implicit(xi, y, column[n_rows + 1 :], system.eliminated)
    cost = column[n_rows] if n_rows in rows else ca.SX(0)
    F = column[[row for row in rows if row < n_rows]]
    lam = ca.SX.sym("lam", F.numel() + 1)
    jacobian = implicit.jacobian(F)
    hessian, gradient = implicit.hessian(ca.dot(lam, ca.vertcat(F, cost)))
    hessian = ca.triu(hessian)

    def function(of: str, inputs: list, outputs: list) -> ca.Function:
        return _function(f"{name}_{of}", inputs, implicit.inserted(outputs))

    functions = {
        f"{name}_value": function("value", [xi, theta], [F]),
        f"{name}_jacobian": function("jacobian", [xi, theta], [nonzeros(jacobian)]),
        f"{name}_hessian": function("hessian", [xi, theta, lam], [ca.densify(gradient), nonzeros(hessian)]),
    }
    if n_rows in rows:
        slope = ca.densify(implicit.jacobian(cost)).T
        functions |= {"node_cost": function("cost", [xi, theta], [cost])}
        functions |= {"node_cost_gradient": function("cost_gradient", [xi, theta], [slope])}
    return functions, {"jacobian_pattern": triplets(jacobian), "hessian_pattern": triplets(hessian)}


def _function(name: str, inputs: list, outputs: list) -> ca.Function:
    shared = ca.n_nodes(ca.veccat(*outputs)) <= _MAX_SHARED_OPERATIONS
    return ca.Function(name, inputs, outputs, {"cse": shared})


def _open_end_rows(system: System, open_end_path: tuple[int, ...]) -> tuple[int, ...]:
    """Return the rows of a node that are imposed at open ends: closure, and the given path quantities."""
    closure = tuple(i for i in range(system.n_equations) if system.kinds[i] == "closure")
    return closure + tuple(system.n_equations + i for i in open_end_path)


def nonzeros(matrix: ca.SX) -> ca.SX:
    """Return a matrix's nonzeros as a column (CasADi gives a row for a row)."""
    return ca.vec(matrix.nz[:])


def triplets(matrix: ca.SX) -> Pattern:
    """Return the rows and columns of a matrix's nonzeros."""
    rows, columns = matrix.sparsity().get_triplet()
    return np.array(rows, dtype=int), np.array(columns, dtype=int)
