"""A continuous problem at one instant: equations, bounded quantities and running cost as functions of a node's unknowns.

A node is (s, v, a, x, r, z, u): positions, velocities and accelerations of second-order coordinates, states x of first-order
equations with their rates r, algebraic unknowns z, efforts u. A system is independent of meshes. Mechanisms and users'
differential equations are both converted to systems.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class System:
    """Equations, bounded quantities and running cost at a node, all scaled to order one.

    `node` maps (xi, theta) to a column [equations (n_equations,); path quantities (n_path,); running cost], where xi
    (n_xi,) stacks a node's scaled unknowns and theta (n_theta,) its parameters.
    """

    n_s: int
    n_x: int
    n_z: int
    n_u: int
    node: ca.Function
    n_equations: int
    n_path: int
    kinds: tuple[str, ...]  # the kind of each equation and path quantity, for messages and tests

    def __post_init__(self) -> None:
        if len(self.kinds) != self.n_equations + self.n_path:
            raise ValueError(f"system has {self.n_equations} + {self.n_path} rows, {len(self.kinds)} kinds")

    @property
    def n_xi(self) -> int:
        """The number of a node's unknowns."""
        return 3 * self.n_s + 2 * self.n_x + self.n_z + self.n_u

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
    x: ca.SX
    r: ca.SX
    z: ca.SX
    u: ca.SX

    @property
    def stacked(self) -> ca.SX:
        """The unknowns in the order of xi."""
        return ca.vertcat(self.s, self.v, self.a, self.x, self.r, self.z, self.u)


def node_symbols(n_s: int, n_x: int, n_z: int, n_u: int) -> NodeSymbols:
    """Return fresh symbols for a node's unknowns."""
    sizes = {"s": n_s, "v": n_s, "a": n_s, "x": n_x, "r": n_x, "z": n_z, "u": n_u}
    return NodeSymbols(**{name: ca.SX.sym(name, size) for name, size in sizes.items()})


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Endpoint:
    """Rows and a cost that depend on both ends of a motion.

    `function` maps (first state, last state, duration, parameters), all scaled, to a column [rows (n_rows,); cost]. If
    `algebraic`, its fifth input is the algebraic unknowns (n_z,) of the last node, which must then lie at the end.
    """

    function: ca.Function
    n_rows: int
    algebraic: bool = False

    @property
    def n_parameters(self) -> int:
        """The number of parameters."""
        return int(self.function.size1_in(3))

    def unknowns(self, first: Any, last: Any, z: Any) -> list:
        """Return the unknowns except the duration in one list: first state, last state, and z if `algebraic`."""
        return [*first, *last, *(z if self.algebraic else ())]

    def at(self, e: ca.SX, duration: ca.SX, parameters: ca.SX, n_state: int) -> ca.SX:
        """Return [rows; cost] at the unknowns e, in the order of `unknowns`."""
        further = [e[2 * n_state :]] if self.algebraic else []
        return ca.densify(self.function(e[:n_state], e[n_state : 2 * n_state], duration, parameters, *further))
