"""Singular poses told apart: dead centres of the coordinate that leads, and poses at which the mechanism itself branches.

J_z loses rank at both. Where J over all rows and joints keeps its rank, the loops still fix the same number of motions: the
coordinate is at a dead centre, and another one leads through it. Where J loses rank too, motions that were forbidden become
possible to first order, and the mechanism may go over to another branch or gain a freedom. Least singular values
show either, also where det J_z touches zero without a change of sign, two loops folding at once.
"""

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled

# A least singular value below this share of home's is zero at a pose found to 1e-8.
_RANK_LOST = 1e-4
# Samples between which a least singular value dips below this share of home's are looked at closely.
_DIP = 0.3
# Directions of a plane that are looked at, half a degree apart; how far [rad] J is followed along one; and the share of the
# largest bend below which a direction goes straight on: at a simple zero a degree away from it, a double one's wider.
_DIRECTIONS, _BEND, _STRAIGHT = 360, 1e-5, 0.02
# A bend below this share of the largest is what differences and a pose found to 1e-6 leave.
_FLAT = 1e-3


def least_values(mechanism: Mechanism, q: np.ndarray) -> np.ndarray:
    """Return the least singular values (2,) of J and of J_z that the closure's rank at home counts, slides by the extent."""
    poses = np.asarray(q)[None]
    return np.array([_least_along(mechanism, poses, columns)[0] for columns in (slice(None), mechanism.dependent)])


def _least_along(mechanism: Mechanism, poses: np.ndarray, columns: slice | np.ndarray) -> np.ndarray:
    """Return the least singular value (n,) that counts, of some columns of J, at poses (n, n_q)."""
    rank = len(mechanism.dependent)
    if rank == 0:
        return np.ones(len(poses))
    unit = np.array([1.0 if joint.kind == "hinge" else mechanism.extent_m for joint in mechanism.joints])
    jacobian = sampled(mechanism.dynamics.closure_jacobian, poses) * unit
    return np.linalg.svd(jacobian[:, :, columns], compute_uv=False)[:, rank - 1]


def is_branching(mechanism: Mechanism, q: np.ndarray) -> bool:
    """Return True if the closure itself loses rank at a singular pose (n_q,), or the coordinate is at a dead centre only."""
    at_home = least_values(mechanism, mechanism.home)[0]
    return bool(least_values(mechanism, q)[0] < _RANK_LOST * at_home)


def closure_rank(mechanism: Mechanism, q: np.ndarray) -> int:
    """Return the rank of the closure at a pose (n_q,), counted against the least singular value at home."""
    unit = np.array([1.0 if joint.kind == "hinge" else mechanism.extent_m for joint in mechanism.joints])
    values = np.linalg.svd(np.array(mechanism.dynamics.closure_jacobian(q)) * unit, compute_uv=False)
    return int(np.sum(values[: len(mechanism.dependent)] > _RANK_LOST * least_values(mechanism, mechanism.home)[0]))


def dips(mechanism: Mechanism, poses: np.ndarray) -> list[int]:
    """Return the samples k of poses (n, n_q), ends left out, at which the least singular value of J_z dips."""
    if len(mechanism.dependent) == 0 or len(poses) < 3:
        return []
    values = _least_along(mechanism, poses, mechanism.dependent)
    at_home = least_values(mechanism, mechanism.home)[1]
    inner = values[1:-1]
    lowest = (inner <= values[:-2]) & (inner <= values[2:]) & (inner < _DIP * at_home)
    return [int(k) + 1 for k in np.flatnonzero(lowest)]


def all_regular(mechanism: Mechanism, poses: np.ndarray) -> bool:
    """Return True if no least singular value of J_z at poses (n, n_q) is so low that it wants a closer look."""
    at_home = least_values(mechanism, mechanism.home)[1]
    return bool(np.all(_least_along(mechanism, poses, mechanism.dependent) >= _DIP * at_home))


def vanishes(mechanism: Mechanism, q: np.ndarray) -> bool:
    """Return True if J_z has lost rank at a pose (n_q,)."""
    return bool(least_values(mechanism, q)[1] < _RANK_LOST * least_values(mechanism, mechanism.home)[1])


def has_one_way_on(mechanism: Mechanism, q: np.ndarray) -> bool:
    """Return True if only one motion leads through a pose (n_q,) at which the closure has lost rank: no branch there.

    Rates x in the kernel of J go on where J x' + (dJ x) x = 0 has a solution x': where u^T (dJ x) x vanishes for all u with
    u^T J = 0 (second-order analysis; Wohlhart, Degrees of shakiness, 1999). One motion alone, of as many freedoms as the
    mechanism has, is where these quadratic forms vanish on a linear space of that dimension and nowhere else. In a kernel of
    two dimensions that is looked at in every direction, in larger ones by `common_zeros`, which may leave it undecided.
    """
    unit = np.array([1.0 if joint.kind == "hinge" else mechanism.extent_m for joint in mechanism.joints])
    rank = closure_rank(mechanism, q)

    def scaled(pose: np.ndarray) -> np.ndarray:
        return np.array(mechanism.dynamics.closure_jacobian(pose)) * unit

    left, _, right = np.linalg.svd(scaled(q))
    apart, kernel = left[:, rank:].T, right[rank:]
    if len(kernel) != 2:
        bends = [(scaled(q + _BEND * unit * x) - scaled(q - _BEND * unit * x)) / (2 * _BEND) for x in kernel]
        forms = np.array([apart @ bend @ kernel.T for bend in bends]).transpose(1, 0, 2)  # u, x, y
        ways = common_zeros(0.5 * (forms + forms.transpose(0, 2, 1)))
        return ways is not None and ways.shape[1] == mechanism.dof
    angles = np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS
    bent = []
    for x in np.column_stack([np.cos(angles), np.sin(angles)]) @ kernel:
        ahead, behind = (scaled(q + sign * _BEND * unit * x) for sign in (1, -1))
        bent.append(np.abs(apart @ (ahead - behind) @ x).max(initial=0.0) / (2 * _BEND))
    size = np.array(bent)
    small = size < _STRAIGHT * size.max()
    # Directions go round: the first follows the last.
    starts = small & ~np.roll(small, 1)
    return size.max() > _RANK_LOST and int(starts.sum()) == 1


def common_zeros(forms: np.ndarray) -> np.ndarray | None:
    """Return a basis (n, k) of the space on which quadratic forms (m, n, n) vanish, where they vanish nowhere else; or None.

    Where a combination of them is semidefinite, all common zeros are in its kernel; there the forms are looked at again,
    until none is left (facial reduction; Borwein & Wolkowicz, J. Austral. Math. Soc. A 30, 1981). Forms of which none is
    semidefinite have common zeros off any linear space, as a rule, or that is not known: None.
    """
    basis, size = np.eye(forms.shape[1]), float(np.abs(forms).max(initial=0.0))
    while True:
        reduced = basis.T @ forms @ basis
        _, values, spanning = np.linalg.svd(reduced.reshape(len(forms), -1), full_matrices=False)
        left = spanning[values > max(_RANK_LOST, _FLAT * size)].reshape(-1, *reduced.shape[1:])
        if not len(left):
            return basis
        found = _semidefinite(left)
        if found is None:
            return None
        shares, axes = np.linalg.eigh(found)
        basis = basis @ axes[:, shares < _FLAT * shares[-1]]
        if basis.shape[1] == 0:
            return basis


def _semidefinite(forms: np.ndarray) -> np.ndarray | None:
    """Return a combination (n, n) of forms (m, n, n) without negative eigenvalues, of trace 1; None where none is found.

    The least eigenvalue is a concave function of the combination: its largest is found, and not a local one.
    """
    import scipy

    traces = np.trace(forms, axis1=1, axis2=2)
    if np.abs(traces).max() < _FLAT:
        return None
    first, others = traces / (traces @ traces), np.linalg.svd(traces[None])[2][1:]

    def combined(y: np.ndarray) -> np.ndarray:
        return np.tensordot(first + y @ others, forms, axes=1)

    y = np.zeros(len(others))
    if len(others):
        kept = {"xatol": 1e-10, "fatol": 1e-12, "maxiter": 2000 * len(others), "initial_simplex": _simplex(len(others))}
        y = scipy.optimize.minimize(lambda y: -np.linalg.eigvalsh(combined(y))[0], y, method="Nelder-Mead", options=kept).x
    found = combined(y)
    shares = np.linalg.eigvalsh(found)
    return found if shares[0] > -_FLAT * shares[-1] else None


def _simplex(n: int) -> np.ndarray:
    return np.vstack([np.zeros(n), np.eye(n)])
