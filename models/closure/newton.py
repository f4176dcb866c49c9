"""Closing loops numerically from a nearby pose, the nearest closed pose, and overconstrained closures.

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

The pose nearest to a reference at which a loop is open is offered to users as a home pose. Newton starts from the reference
and from many poses around it. The best closed poses are brought within the joints' ranges by bounded least squares (Branch,
Coleman & Li, SIAM J. Sci. Comput. 21, 1999). Then they move towards the reference along the closure, q' = P (q_ref - q),
where P projects onto the null space of J.
"""

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from random import Random

import casadi as ca
import numpy as np

from linkplan.models.closure.equations import Closure
from linkplan.models.closure.rank import RANK_TOLERANCE, ROUNDING_SHARE, numerical_rank, shares
from linkplan.models.compiled.functions import on_arrays
from linkplan.models.deadline import Deadline
from linkplan.models.tree.coordinates import Coordinates
from linkplan.models.tree.joints import POSITION_ROUNDING, Joint

# Largest gap [m] of a closed loop: a hundredth of the 1e-9 m that certificates promise, and far above rounding.
CLOSED_M = 1e-11
# A larger gap of a loop at the model's reference pose [m] is a fault of the file; a smaller one is rounding: exporters write
# positions to a hundredth of a millimetre.
OPEN_M = 1e-5

# Longest step of a joint [rad or m]: short enough for Newton to stay on its branch.
_MAX_STEP = 0.3
# Newton ignores singular values of J below this share of the largest.
_LEAST_SINGULAR_SHARE = 1e-10
# Distances of the random start poses from the reference [rad; extents on a slide].
_START_DISTANCES = (0.3, 1.0, 2.0)
# A pose is nearly singular if a singular value of its closure is below this share of the largest.
_NEARLY_SINGULAR_SHARE = 0.02


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class KinematicLoop:
    """A mechanism's closure as numbers: `function` maps q (n_q,) to phi [m] and J, which is sparse.

    `unit` (n_q,) is a unit step of each joint [rad or m], see `tree.joints.unit_steps`. A loop counts as closed below the
    gap `closed_m` [m]. Singular values below `rank_tolerance` times the largest count as zero. Both tolerances are larger
    for a file with rounded numbers, see `closure.mobility`.
    """

    name: str  # of the mechanism
    joints: tuple[Joint, ...]
    coordinates: Coordinates
    closures: tuple[Closure, ...]
    unit: np.ndarray
    function: ca.Function
    closed_m: float = CLOSED_M
    rank_tolerance: float = RANK_TOLERANCE

    def residual(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return phi (n_rows,) [m] and its Jacobian (n_rows, n_q)."""
        phi, entries = np.empty(self.function.numel_out(0)), np.empty(self.function.nnz_out(1))
        on_arrays(self.function, [np.array(q, dtype=float)], [phi, entries])()
        jacobian = np.zeros((len(phi), len(q)))
        jacobian.ravel()[_places(self.function)] = entries
        return phi, jacobian

    @property
    def pattern(self) -> np.ndarray:
        """A mask (n_rows, n_q) of the entries of J that are not zero at every pose."""
        return np.array(ca.DM(self.function.sparsity_out(1), 1.0).full() != 0)

    def gap(self, phi: np.ndarray) -> float:
        """Return the largest gap [m] in values of phi; an angle counts with its lever."""
        return self.widest(phi)[0]

    def widest(self, phi: np.ndarray) -> tuple[float, str]:
        """Return the largest gap [m] in values of phi, and the name of its closure."""
        return max(((float(np.linalg.norm(phi[one.rows])), one.name) for one in self.closures), default=(0.0, ""))

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Return J (n_rows, n_q) [m] with columns per unit step of each joint."""
        return self.residual(q)[1] * self.unit

    def rank(self, q: np.ndarray) -> int:
        """Return the closure's rank at a pose."""
        return numerical_rank(self.jacobian(q), self.rank_tolerance)


@functools.lru_cache(maxsize=64)
def _places(function: ca.Function) -> np.ndarray:
    """Return the index of each entry of a sparse Jacobian in the flattened dense matrix."""
    pattern = function.sparsity_out(1)
    return np.array(pattern.row(), dtype=int) * pattern.size2() + np.array(pattern.get_col(), dtype=int)


def close(loop: KinematicLoop, start: np.ndarray, free: Sequence[int] | None = None) -> tuple[np.ndarray, float]:
    """Return the pose that Newton reaches from `start` by moving the joints in `free`, by default all, and its gap [m].

    The pose may be open.
    """
    rcond = _LEAST_SINGULAR_SHARE if loop.rank_tolerance <= RANK_TOLERANCE else loop.rank_tolerance
    q, phi = root_by_newton(loop.residual, start, list(range(len(start)) if free is None else free), rcond)
    return q, loop.gap(phi)


def root_by_newton(
    residual: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    start: np.ndarray,
    free: list[int],
    rcond: float = _LEAST_SINGULAR_SHARE,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pose of least residual that Newton reaches by moving the joints in `free`, and its residual phi.

    The steps have minimum norm, so redundant rows and spare freedom do no harm. Steps are shortened if they are too long or
    do not reduce the residual. The iteration ends where a step would remove only rounding, or a share of the residual that
    is too small to change its norm.

    Args:
        residual: q -> phi, J.
        start: the first pose (n_q,).
        free: indices of joints.
        rcond: singular values below this share of the largest are ignored.
    """
    q = np.array(start, dtype=float)
    phi, jacobian = residual(q)
    if phi.size == 0 or not free:
        return q, phi
    for _ in range(100):
        step = np.zeros_like(q)
        step[free] = np.linalg.lstsq(jacobian[:, free], -phi, rcond=rcond)[0]
        size = np.abs(step).max()
        norm, removed = np.linalg.norm(phi), np.linalg.norm(jacobian @ step)
        if not np.isfinite(size) or size < 1e-15 or removed <= max(1e-15, 1e-8 * norm):
            break
        scale = min(1.0, _MAX_STEP / size)
        while scale > 1e-6:
            trial = q + scale * step
            phi_trial, jacobian_trial = residual(trial)
            if np.linalg.norm(phi_trial) < norm:
                break
            scale *= 0.5
        else:
            break
        q, phi, jacobian = trial, phi_trial, jacobian_trial
    return q, phi


def least_gap(loop: KinematicLoop, start: np.ndarray, free: list[int]) -> tuple[float, str]:
    """Return the gap [m] near `start` of a loop that does not close, by least squares, and the name of its closure."""
    import scipy

    def at(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        q = np.array(start, dtype=float)
        q[free] = x
        phi, jacobian = loop.residual(q)
        return phi, jacobian[:, free]

    if not free:
        return loop.widest(loop.residual(start)[0])
    found = scipy.optimize.least_squares(
        lambda x: at(x)[0], start[free], lambda x: at(x)[1], xtol=1e-8, ftol=1e-8, gtol=1e-14, max_nfev=200
    )
    return loop.widest(found.fun)


def follow(
    loop: KinematicLoop, start: np.ndarray, held: dict[int, float], longest_step: float = 0.035
) -> tuple[np.ndarray, float]:
    """Return the pose and gap [m] after moving the joints in `held` from the closed pose `start` to their values.

    The held joints move on a straight line in steps of at most `longest_step` [rad or m], so that Newton stays on the
    branch. If the loop opens on the way, the pose and gap there are returned.
    """
    free = [i for i in range(len(start)) if i not in held]
    joints, goal = list(held), np.array(list(held.values()))
    begin = start[joints]
    n_steps = max(1, int(np.ceil(np.abs(goal - begin).max() / longest_step)))
    q, gap = start, 0.0
    for fraction in np.linspace(0.0, 1.0, n_steps + 1)[1:]:
        trial = np.array(q)
        trial[joints] = begin + fraction * (goal - begin)
        q, gap = close(loop, trial, free)
        if gap > loop.closed_m:
            break
    return q, gap


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
    exact = [np.allclose(C @ J[kept], J[rows], tolerance, tolerance) for J, C in zip(samples, maps, strict=True)]
    same = all(exact) and np.allclose(maps, maps[0], tolerance, tolerance)
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


def nearest_closed_pose(loop: KinematicLoop, reference: np.ndarray) -> np.ndarray | None:
    """Return the closed pose (n_q,) found nearest to a pose, preferably regular and within the joints' ranges, or None."""
    deadline, closed = Deadline().within(2.0), []  # [s]: a model of seventy joints needs a second for a start
    for start in _starts(loop, reference):
        if closed and deadline.passed:
            break
        if (pose := _closed(loop, start)) is not None:
            closed.append(pose)
    if not closed:
        return None
    largest = np.max([shares(loop.jacobian(pose)) for pose in closed], axis=0)
    # Some singular values are small at every closed pose. At a regular pose they are not far smaller than at the others.
    least = np.where(largest > _NEARLY_SINGULAR_SHARE, _NEARLY_SINGULAR_SHARE, _NEARLY_SINGULAR_SHARE * largest)
    least[largest <= loop.rank_tolerance] = 0.0

    def regular(pose: np.ndarray) -> bool:
        return bool(np.all(shares(loop.jacobian(pose)) >= least))

    def measure(pose: np.ndarray) -> tuple[bool, float, float]:
        # Mirror images are equally near: rounding does not choose between them.
        away = float(np.linalg.norm((pose - reference) / loop.unit))
        return not regular(pose), round(_outside(loop, pose), 9), round(away, 9)

    best = sorted(closed, key=measure)[: len(closed) // 4 + 1]
    deadline = Deadline().within(2.0)  # [s]
    inside = (_brought_within_ranges(loop, pose) for pose in best)
    return min((_moved_to_reference(loop, pose, reference, measure, deadline) for pose in inside), key=measure)


def within_ranges(loop: KinematicLoop, reference: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return the closed pose `near` an open reference, or the nearest one within the ranges if `near` leaves them."""
    if _outside(loop, near) == 0.0 or loop.gap(loop.residual(reference)[0]) <= OPEN_M:
        return near
    other = nearest_closed_pose(loop, reference)
    return near if other is None or _outside(loop, other) > 0.0 else other


def _starts(loop: KinematicLoop, reference: np.ndarray, n_random: int = 60) -> Iterator[np.ndarray]:
    """Yield the reference and random poses around it, the same ones in every run."""
    yield reference
    rng = np.random.default_rng(0)
    low, high = np.array([(joint.lower, joint.upper) for joint in loop.joints]).T
    for number in range(n_random):
        distance = _START_DISTANCES[number % len(_START_DISTANCES)]
        start = reference + distance * loop.unit * rng.uniform(-1.0, 1.0, len(reference))
        yield np.clip(start, low, high)


def _closed(loop: KinematicLoop, start: np.ndarray) -> np.ndarray | None:
    pose, gap = close(loop, start)
    return pose if gap <= loop.closed_m else None


def _outside(loop: KinematicLoop, pose: np.ndarray) -> float:
    """Return the largest violation of a joint's range [rad or m]; 0 within rounding."""
    worst = max(max(joint.lower - x, x - joint.upper) for joint, x in zip(loop.joints, pose, strict=True))
    return max(float(worst), 0.0) if worst > POSITION_ROUNDING else 0.0


def _brought_within_ranges(loop: KinematicLoop, pose: np.ndarray) -> np.ndarray:
    """Return a closed pose within the joints' ranges, by bounded least squares from a closed pose; else the latter."""
    if _outside(loop, pose) == 0.0:
        return pose
    import scipy

    # The ends of a range are admissible, and a range may have no width at all.
    low, high = np.array([(x.lower - POSITION_ROUNDING, x.upper + POSITION_ROUNDING) for x in loop.joints]).T
    phi, jacobian = (lambda q: loop.residual(q)[0]), (lambda q: loop.residual(q)[1])
    begin, limits = np.clip(pose, low, high), {"bounds": (low, high), "x_scale": loop.unit, "max_nfev": 200}
    found = scipy.optimize.least_squares(phi, begin, jacobian, **limits)
    inside = _closed(loop, found.x)
    return pose if inside is None or _outside(loop, inside) > 0.0 else inside


def _moved_to_reference(
    loop: KinematicLoop, pose: np.ndarray, reference: np.ndarray, measure, deadline: Deadline
) -> np.ndarray:
    """Return the closed pose reached from `pose` by steps towards the reference that each decrease `measure`."""
    moved = np.abs(loop.jacobian(pose)).max(axis=0)
    trial, step = _closed(loop, np.where(moved > 1e-6 * moved.max(), pose, reference)), 1.0  # joints outside loops stay
    pose = pose if trial is None else min(pose, trial, key=measure)
    for _ in range(100):
        if deadline.passed:
            break
        free = np.linalg.svd(loop.jacobian(pose))[2][loop.rank(pose) :]
        trial = _closed(loop, pose + step * loop.unit * (free.T @ (free @ ((reference - pose) / loop.unit))))
        if trial is not None and measure(trial) < measure(pose):
            pose, step = trial, min(1.0, 2 * step)
        elif step > 1e-3:
            step *= 0.5
        else:
            break
    return pose
