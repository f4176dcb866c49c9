"""Singular poses: dead centres of the independent coordinate, and poses at which the mechanism itself may branch.

J_z loses rank at both. If J over all rows and joints keeps its rank, the independent coordinate is at a dead centre, and
another choice of coordinate passes the pose. If J loses rank too, further motions are possible to first order, and the
mechanism may change its branch or gain a freedom. Least singular values detect both, also where det J_z touches zero without
a change of sign because two loops fold at once.
"""

import functools
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.models.closure.rank import blocks
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled
from linkplan.models.tree.joints import unit_steps

# A singular value below this share of the least one at home counts as zero; singular poses are found to about 1e-8.
_RANK_LOST = 1e-4
# A local minimum of the least singular value is examined if it is below this share of the value at home.
_SUSPECT_SHARE = 0.3
# Step of the central differences of J [rad; extents on a slide].
_DIFFERENCE_STEP = 1e-5
# A quadratic form below this share of the largest is zero to the accuracy of differences and pose.
_ZERO_FORM_SHARE = 1e-3


def least_values(mechanism: Mechanism, q: np.ndarray) -> np.ndarray:
    """Return the r-th largest singular values (2,) of J and of J_z at q, where r is the rank of the closure at home.

    Columns of slides are multiplied by the extent.
    """
    poses = np.asarray(q)[None]
    return np.array([_least_along(mechanism, poses, dependent=dependent)[0] for dependent in (False, True)])


def _least_along(mechanism: Mechanism, poses: np.ndarray, *, dependent: bool) -> np.ndarray:
    """Return the r-th largest singular value (n,), r as in `least_values`, of J or of J_z at poses (n, n_q)."""
    rank = len(mechanism.dependent)
    if rank == 0:
        return np.ones(len(poses))
    found = []
    for part, at_home in zip(_parts(mechanism), _values_at_home(mechanism, dependent=dependent), strict=True):
        moved = np.any(poses[:, part.columns] != mechanism.home[part.columns])
        values = _values(mechanism, part, poses, dependent=dependent) if moved else at_home
        found.append(np.broadcast_to(values, (len(poses), values.shape[1])))
    return np.sort(np.hstack(found), axis=1)[:, -rank]


@functools.lru_cache(maxsize=16)
def _values_at_home(mechanism: Mechanism, *, dependent: bool) -> list[np.ndarray]:
    """Return the singular values (1, k) of each part's block of J or of J_z at home."""
    return [_values(mechanism, part, mechanism.home[None], dependent=dependent) for part in _parts(mechanism)]


def _values(mechanism: Mechanism, part: "_Part", poses: np.ndarray, *, dependent: bool) -> np.ndarray:
    """Return the singular values (n, k) at poses (n, n_q) of a part's block of J or of J_z."""
    J = sampled(part.jacobian, poses) * unit_steps(mechanism.joints, mechanism.extent_m)[part.columns]
    return np.linalg.svd(J[:, :, np.isin(part.columns, mechanism.dependent)] if dependent else J, compute_uv=False)


@dataclass(frozen=True, eq=False, slots=True)
class _Part:
    """Loops that share joints with no others: the joints `columns` of the mechanism, and their Jacobian by the pose."""

    columns: np.ndarray
    jacobian: ca.Function


@functools.lru_cache(maxsize=16)
def _parts(mechanism: Mechanism) -> list[_Part]:
    """Return the parts of the closure that depend on different joints; J is block diagonal, with one block for each."""
    q = ca.SX.sym("q", mechanism.n_q)
    J = mechanism.dynamics.closure_jacobian(q)
    pattern = np.array(ca.DM(mechanism.dynamics.closure.jac_sparsity(0, 0), 1.0), dtype=bool)
    found = []
    for rows, columns in blocks(pattern):
        block = ca.densify(J[rows.tolist(), columns.tolist()])
        found.append(_Part(columns, ca.Function("part", [q], [block])))
    return found


def _jacobians(mechanism: Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return J (n, n_rows, n_q) [m] at poses (n, n_q), each column multiplied by its joint's unit step."""
    return sampled(mechanism.dynamics.closure_jacobian, poses) * unit_steps(mechanism.joints, mechanism.extent_m)


def closure_rank(mechanism: Mechanism, q: np.ndarray) -> int:
    """Return the rank of the closure at a pose (n_q,), relative to the least singular value at home.

    At a singular pose it equals the rank at home if the coordinate is only at a dead centre; it is smaller if J loses rank.
    """
    values = np.linalg.svd(_jacobians(mechanism, q[None])[0], compute_uv=False)
    return int(np.sum(values[: len(mechanism.dependent)] > _RANK_LOST * least_values(mechanism, mechanism.home)[0]))


def local_minima(mechanism: Mechanism, poses: np.ndarray) -> list[int]:
    """Return the inner samples of poses (n, n_q) at which the least singular value of J_z has a low local minimum."""
    if len(mechanism.dependent) == 0 or len(poses) < 3:
        return []
    values = _least_along(mechanism, poses, dependent=True)
    at_home = least_values(mechanism, mechanism.home)[1]
    inner = values[1:-1]
    lowest = (inner <= values[:-2]) & (inner <= values[2:]) & (inner < _SUSPECT_SHARE * at_home)
    return [int(k) + 1 for k in np.flatnonzero(lowest)]


def all_regular(mechanism: Mechanism, poses: np.ndarray) -> bool:
    """Return True if the least singular value of J_z is far from zero at all poses (n, n_q)."""
    at_home = least_values(mechanism, mechanism.home)[1]
    return bool(np.all(_least_along(mechanism, poses, dependent=True) >= _SUSPECT_SHARE * at_home))


def is_singular(mechanism: Mechanism, q: np.ndarray) -> bool:
    """Return True if J_z loses rank at a pose (n_q,)."""
    return bool(least_values(mechanism, q)[1] < _RANK_LOST * least_values(mechanism, mechanism.home)[1])


def has_single_motion(mechanism: Mechanism, q: np.ndarray) -> bool:
    """Return True if a single motion passes through a pose (n_q,) at which J loses rank, so that there is no branch.

    A rate x in the kernel of J can be continued to second order if J x' + (dJ x) x = 0 has a solution x', that is if
    u^T (dJ x) x vanishes for all u with u^T J = 0 (Wohlhart, Degrees of shakiness, 1999). There is a single motion with
    the mechanism's degrees of freedom if these quadratic forms vanish exactly on a linear space of that dimension, which
    `common_zeros` finds. In a kernel of two dimensions it decides; in larger ones it may be undecided.
    """
    unit = unit_steps(mechanism.joints, mechanism.extent_m)
    rank = closure_rank(mechanism, q)
    left, _, right = np.linalg.svd(_jacobians(mechanism, q[None])[0])
    left_kernel, kernel = left[:, rank:].T, right[rank:]

    def derivative(x: np.ndarray) -> np.ndarray:
        step = _DIFFERENCE_STEP * unit * x
        after, before = _jacobians(mechanism, np.array([q + step, q - step]))
        return (after - before) / (2 * _DIFFERENCE_STEP)

    forms = np.array([left_kernel @ derivative(x) @ kernel.T for x in kernel]).transpose(1, 0, 2)  # u, x, y
    motions = common_zeros(0.5 * (forms + forms.transpose(0, 2, 1)))
    return motions is not None and motions.shape[1] == mechanism.dof


def common_zeros(forms: np.ndarray) -> np.ndarray | None:
    """Return a basis (n, k) of the linear space of all common zeros of quadratic forms (m, n, n), or None if unknown.

    If a combination of the forms is semidefinite, all common zeros are in its kernel. The forms are restricted to that
    kernel until all vanish (facial reduction; Borwein & Wolkowicz, J. Austral. Math. Soc. A 30, 1981). Without a
    semidefinite combination the common zeros are in general not a linear space, and the result is None.
    """
    basis, size = np.eye(forms.shape[1]), float(np.abs(forms).max(initial=0.0))
    while True:
        reduced = basis.T @ forms @ basis
        _, values, spanning = np.linalg.svd(reduced.reshape(len(forms), -1), full_matrices=False)
        left = spanning[values > max(_RANK_LOST, _ZERO_FORM_SHARE * size)].reshape(-1, *reduced.shape[1:])
        if not len(left):
            return basis
        found = _semidefinite(left)
        if found is None:
            return None
        shares, axes = np.linalg.eigh(found)
        basis = basis @ axes[:, shares < _ZERO_FORM_SHARE * shares[-1]]
        if basis.shape[1] == 0:
            return basis


def _semidefinite(forms: np.ndarray) -> np.ndarray | None:
    """Return a semidefinite combination (n, n) of forms (m, n, n) with trace 1, or None if none is found.

    The least eigenvalue is a concave function of the combination, so a local maximum is the global one.
    """
    import scipy

    traces = np.trace(forms, axis1=1, axis2=2)
    if np.abs(traces).max() < _ZERO_FORM_SHARE:
        return None
    first, others = traces / (traces @ traces), np.linalg.svd(traces[None])[2][1:]

    def combined(y: np.ndarray) -> np.ndarray:
        return np.tensordot(first + y @ others, forms, axes=1)

    y = np.zeros(len(others))
    if len(others):
        simplex = np.vstack([y, np.eye(len(others))])
        settings = {"xatol": 1e-10, "fatol": 1e-12, "maxiter": 2000 * len(others), "initial_simplex": simplex}
        y = scipy.optimize.minimize(
            lambda y: -np.linalg.eigvalsh(combined(y))[0], y, method="Nelder-Mead", options=settings
        ).x
    found = combined(y)
    shares = np.linalg.eigvalsh(found)
    return found if shares[0] > -_ZERO_FORM_SHARE * shares[-1] else None
