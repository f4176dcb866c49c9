"""Overconstrained closures, whose rows depend on one another only at closed poses.

In a planar loop the third row is a constant combination of the other two at every pose, closed or open, so the same two rows
serve everywhere. In a Bennett or Bricard linkage, or with coupled cranks, the rows are dependent only at closed poses, and
their combination changes with the pose. Rows chosen at one pose then lose rank at another regular pose. All such rows are
kept, and the closure is solved by its normal equations,

    E phi = 0,   E = D J_z^T   (D constant, positive),

whose matrix E J_z = D J_z^T J_z is regular where J_z has full column rank (Golub & Van Loan, Matrix Computations, 5.3). At
closed poses velocities, accelerations and forces are exact: E (J q' = 0) has the same solution as J q' = 0, and
E^T (E J_z)^-T gives the forces of least norm on all rows.

If only rounding of the file locks the motion, phi does not vanish along it. The rates then follow from
d(E phi)/dq = E J + (dE/dq) phi. With E J alone the planned velocity would differ slightly from the slope of the planned
position.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from random import Random

import casadi as ca
import numpy as np

from linkplan.models.closure.newton import KinematicLoop
from linkplan.models.closure.rank import ROUNDING_SHARE


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ProjectedLoops:
    """Coupled loops that are solved by the normal equations of all their rows.

    `rows` are rows of phi and `columns` indices into the dependent coordinates. Division by `lengths` (n_columns,) scales
    the columns of J_z to order one. If `inexact`, phi does not vanish and the derivative of E is needed.
    """

    rows: tuple[int, ...]
    columns: tuple[int, ...]
    lengths: tuple[float, ...]
    inexact: bool = False


def jacobians_at_random(loop: ca.Function) -> list[np.ndarray]:
    """Return J (n_rows, n_q), a function's last output, at three random open poses, the same ones in every run."""
    random = Random(0)
    poses = [[random.uniform(-1.0, 1.0) for _ in range(loop.size1_in(0))] for _ in range(3)]
    return [np.array(loop.call([q])[-1]) for q in poses]


def constant_combination(
    samples: Sequence[np.ndarray], rows: Sequence[int], kept: Sequence[int], tolerance: float
) -> np.ndarray | None:
    """Return the constant C with J_rows = C J_kept in all sampled Jacobians (n_rows, n_q), or None if there is none."""
    maps = [J[rows] @ np.linalg.pinv(J[kept]) for J in samples]
    size = max(1.0, *(np.abs(J[rows]).max() for J in samples))
    residual = max(np.abs(J[rows] - C @ J[kept]).max() for J, C in zip(samples, maps, strict=True))
    same = residual <= tolerance * size and max(np.abs(C - maps[0]).max() for C in maps) <= tolerance
    return maps[0] if same else None


def projected_loops(
    loop: KinematicLoop,
    rows: Sequence[int],
    dependent: Sequence[int],
    home: np.ndarray,
    noise: float = 0.0,
    *,
    inexact: bool = False,
) -> tuple[ProjectedLoops, ...]:
    """Return the loops whose dependent rows are not a constant combination of the independent rows.

    Args:
        loop: the closure.
        rows: the independent rows of phi.
        dependent: indices of the dependent coordinates.
        home: a closed, regular pose (n_q,).
        noise: error of J due to rounding of the file, as a share of its largest entry.
        inexact: True if only rounding of the file locks the motion.
    """
    found = []
    samples = jacobians_at_random(loop.function) if len(rows) else []
    at_home = loop.residual(home)[1]
    tolerance = max(ROUNDING_SHARE, noise)
    for of, columns in _components(loop.function.sparsity_out(1), dependent):
        kept = [row for row in of if row in rows]
        if len(kept) == len(of) or not kept:
            continue
        if constant_combination(samples, of, kept, tolerance) is not None:
            continue
        J_z = at_home[np.ix_(of, [dependent[k] for k in columns])]
        lengths = tuple(float(x) for x in np.linalg.norm(J_z, axis=0))
        found.append(ProjectedLoops(rows=tuple(of), columns=tuple(columns), lengths=lengths, inexact=inexact))
    return tuple(found)


def combination(J_z: ca.SX, rows: Sequence[int], loops: Sequence[ProjectedLoops]) -> ca.SX:
    """Return E (rank, n_rows): unit rows for the independent rows, and D J_z^T for the rows of projected loops."""
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
    """Return the connected groups of rows and dependent columns in the sparsity of J_z."""
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
