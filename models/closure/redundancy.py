"""Overconstrained closures: which of their rows depend on one another only where the loops are closed.

A planar loop's third row is a constant combination of the other two wherever the joints stand, closed or not: two rows
chosen once serve everywhere. The rows of a Bennett linkage, of coupled cranks or of Bricard's depend on one another on
the closed
poses only, by a combination that turns with the mechanism; rows chosen at one pose lose rank at another where the
mechanism is regular. Such rows are all kept, and the closure is solved in their normal equations,

    E phi = 0,   E = D J_z^T   (D constant, positive),

whose matrix E J_z = D J_z^T J_z is regular wherever J_z has full column rank (Golub & Van Loan, Matrix Computations, 5.3).
On closed poses velocities, accelerations and forces are exact: E (J q' = 0) has the same solution, and E^T (E J_z)^-T gives
the least forces on all rows.

Where a file's rounding alone forbids the motion, phi does not vanish: the loops gape, and E phi = 0 at poses whose own rates
follow from d(E phi)/dq = E J + (dE/dq) phi and not from E J. What is left out would be a planned velocity that is not quite
the planned position's slope.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from random import Random

import casadi as ca
import numpy as np

# A combination of rows that holds at poses taken at random to this share of the largest entry is constant.
_CONSTANT = 1e-9


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ProjectedLoops:
    """Loops that hang together and are closed in the normal equations of all their rows.

    `rows` of phi and `columns`, places among the dependent coordinates; `lengths` (n_columns,) are what makes the columns of
    J_z of order one. `gapes` says that phi does not vanish, and the derivative of E counts.
    """

    rows: tuple[int, ...]
    columns: tuple[int, ...]
    lengths: tuple[float, ...]
    gapes: bool = False


def jacobians_at_random(jacobian: ca.Function) -> list[np.ndarray]:
    """Return q -> J (n_rows, n_q) at three poses taken at random, closed or not: the same ones in every run."""
    random = Random(0)
    poses = [[random.uniform(-1.0, 1.0) for _ in range(jacobian.size1_in(0))] for _ in range(3)]
    return [np.array(jacobian(q)) for q in poses]


def projected_loops(
    jacobian: ca.Function,
    rows: Sequence[int],
    dependent: Sequence[int],
    home: np.ndarray,
    noise: float = 0.0,
    *,
    gapes: bool = False,
) -> tuple[ProjectedLoops, ...]:
    """Return the loops whose dependent rows are no constant combination of the chosen ones.

    Args:
        jacobian: q -> J (n_rows, n_q), sparse.
        rows: of phi, independent ones.
        dependent: the coordinates that are solved for.
        home: a closed, regular pose (n_q,).
        noise: what share of the largest entry a file's rounding puts into J.
        gapes: whether rounding alone forbids the motion.
    """
    found = []
    samples = jacobians_at_random(jacobian) if len(rows) else []
    at_home = np.array(jacobian(home))
    tolerance = max(_CONSTANT, noise)
    for of, columns in _components(jacobian.sparsity_out(0), dependent):
        kept = [row for row in of if row in rows]
        if len(kept) == len(of) or not kept:
            continue
        maps = [J[of] @ np.linalg.pinv(J[kept]) for J in samples]
        size = max(np.abs(J[of]).max() for J in samples)
        residual = max(np.abs(J[of] - C @ J[kept]).max() for J, C in zip(samples, maps, strict=True))
        if residual <= tolerance * max(1.0, size) and max(np.abs(C - maps[0]).max() for C in maps) <= tolerance:
            continue
        J_z = at_home[np.ix_(of, [dependent[k] for k in columns])]
        lengths = tuple(float(x) for x in np.linalg.norm(J_z, axis=0))
        found.append(ProjectedLoops(rows=tuple(of), columns=tuple(columns), lengths=lengths, gapes=gapes))
    return tuple(found)


def combination(J_z: ca.SX, rows: Sequence[int], loops: Sequence[ProjectedLoops]) -> ca.SX:
    """Return E (rank, n_rows): ones on the chosen rows, and D J_z^T over the rows of projected loops."""
    E = ca.SX(len(rows), J_z.shape[0])
    left = [int(row) for row in rows]
    for loop in loops:
        places = [place for place, row in enumerate(left) if row in loop.rows]
        for place, column, length in zip(places, loop.columns, loop.lengths, strict=True):
            E[place, list(loop.rows)] = J_z[list(loop.rows), column].T / length
        for place in places:
            left[place] = -1
    for place, row in enumerate(left):
        if row >= 0:
            E[place, row] = 1
    return ca.sparsify(E)


def _components(sparsity: ca.Sparsity, dependent: Sequence[int]) -> list[tuple[list[int], list[int]]]:
    """Return the groups of rows and dependent columns that hang together by the structure of J_z."""
    there = np.array(ca.DM(sparsity, 1.0)).astype(bool)[:, [int(i) for i in dependent]]
    left, groups = set(range(len(dependent))), []
    while left:
        columns, rows = {min(left)}, set()
        while True:
            rows = set(np.flatnonzero(there[:, sorted(columns)].any(axis=1)).tolist())
            more = set(np.flatnonzero(there[sorted(rows)].any(axis=0)).tolist()) | columns
            if more == columns:
                break
            columns = more
        left -= columns
        groups.append((sorted(rows), sorted(columns)))
    return groups
