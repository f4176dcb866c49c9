"""The blocks of a mechanism's model that a proof evaluates: closure, dynamics of the open tree, moment arms.

The reduced dynamics are one long expression in the planner's program. Here closure, tree and arms are evaluated one after
another and joined by small linear systems, so that the cost grows with their sum and not with their product.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.models.compiled.functions import on_arrays
from linkplan.models.mechanism import Mechanism
from linkplan.planner.proof.walk import Walk, walk_of


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Blocks:
    """The model's blocks as walks, and the closure as a function of numbers.

    `closure` is q -> E phi (rank,), `tangent` is q -> d(E phi)/dq (rank, n_q), `tree` is (q, q', q'') -> generalised forces
    (n_q,) of the tree with open loops, `arms` is q -> B (n_q, n_u), `convective` is (q, q') -> J' q' (rank,). `force_map` is
    q -> the matrix (n_rows, rank) from multipliers to the forces of least norm on all rows.
    """

    mechanism: Mechanism
    independent: tuple[int, ...]
    dependent: tuple[int, ...]
    closure: Walk
    tangent: Walk
    numbers: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # q -> E phi (rank,), J (rank, n_q)
    tree: Walk
    arms: Walk
    convective: Walk
    force_map: Walk
    n_rows: int

    @property
    def rank(self) -> int:
        """The number of dependent coordinates."""
        return len(self.dependent)


@functools.lru_cache(maxsize=16)
def blocks_of(mechanism: Mechanism) -> Blocks:
    """Return the blocks of a mechanism.

    Raises:
        UnknownOperationError: when the model has an operation that balls do not enclose.
    """
    dynamics = mechanism.dynamics
    q, rates, _ = motion = [ca.SX.sym(name, mechanism.n_q) for name in ("q", "qd", "qdd")]
    phi = dynamics.independent_closure(q)
    jacobian = ca.jacobian(phi, q)
    return Blocks(
        mechanism=mechanism,
        independent=tuple(int(i) for i in mechanism.independent),
        dependent=tuple(int(i) for i in mechanism.dependent),
        closure=_walk("closure", [q], phi),
        tangent=_walk("tangent", [q], jacobian),
        numbers=_in_numbers(ca.Function("numbers", [q], [ca.densify(phi), ca.densify(jacobian)])),
        tree=_walk("tree", motion, dynamics.tree_effort(*motion)),
        arms=_walk("arms", [q], ca.sparsify(dynamics.effort_matrix(q))),
        convective=_walk("convective", [q, rates], ca.jtimes(jacobian @ rates, q, rates)),
        force_map=_walk("force_map", [q], ca.sparsify(dynamics.force_map(q))),
        n_rows=mechanism.n_closure_rows,
    )


def _walk(name: str, inputs: list[ca.SX], output: ca.SX) -> Walk:
    """Return the walk of an expression without repeated operations."""
    return walk_of(ca.Function(name, inputs, [output], {"cse": True}))


def _in_numbers(function: ca.Function) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Return a call of a function of the pose with a column and a matrix as its outputs, on arrays."""
    pose, column = np.empty(function.numel_in(0)), np.empty(function.numel_out(0))
    matrix = np.empty(function.size_out(1), order="F")
    entries = matrix.reshape(-1, order="F")
    evaluate = on_arrays(function, [pose], [column, entries])

    def numbers(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pose[:] = q
        evaluate()
        return column.copy(), matrix.copy()

    return numbers


@functools.lru_cache(maxsize=16)
def loaded_tree(mechanism: Mechanism, payload_factor: float) -> Walk:
    """Return the walk of (q, q', q'') -> generalised forces with the payload's mass and inertia times a factor."""
    numbers = np.array(mechanism.payload.numbers(), dtype=float)
    numbers[[0, 4, 5, 6]] *= payload_factor
    symbols = [ca.SX.sym(name, mechanism.n_q) for name in ("q", "qd", "qdd")]
    loaded = mechanism.parametric_dynamics().tree_effort(*symbols, ca.SX(ca.DM(numbers)))
    return _walk("loaded_tree", symbols, ca.densify(loaded))
