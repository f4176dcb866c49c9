"""Inverse kinematics: poses on the assembled branch with sites at given points and bodies at given angles.

The method is Levenberg-Marquardt in the independent positions s, with the loops closed at every step (Nocedal & Wright,
Numerical Optimization, 10.3). It minimises the squared distances of the sites and of the bodies, whose angle counts
as an arc at the mechanism's extent. Independent ranges bound the step, and dependent ranges are steep penalties. Several
starts are used, the same in every run, and the solution nearest to the first start is the result.
"""

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from linkplan.models.closure.rank import FILE_ROUNDING_SHARE
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled
from linkplan.models.poses.assembly import close_at
from linkplan.models.tree.joints import POSITION_ROUNDING, unit_steps

# Largest distance of a site from its target, as a share of the mechanism's extent.
ARRIVED_SHARE = 1e-9
# Longest step [rad or extents].
_MAX_STEP = 0.5
# The iteration ends if a step [rad or extents], or its relative gain (a target out of reach), is below this.
_CONVERGED_STEP = 1e-14
# Weight of a dependent joint's range violation against a site's distance.
_RANGE_WEIGHT = 1e3


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SiteTargets:
    """Target points of sites, and target angles of bodies.

    `sites` (n,) are indices in the model and `points` (n, 3) [m] in the world, NaN where free. The angle of a body is
    `turning` @ q (`body_angles.turning`, (m, n_q)), and `angles` (m,) [rad] are the targets.
    """

    sites: np.ndarray
    points: np.ndarray
    turning: np.ndarray | None = None
    angles: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def given(self) -> np.ndarray:
        """A mask (3 n + m,) of the prescribed coordinates of the sites, and of the angles, which are all prescribed."""
        return np.concatenate([~np.isnan(self.points.ravel()), np.full(len(self.angles), True)])

    def beyond(self, q: np.ndarray) -> np.ndarray:
        """Return the differences (m,) [rad] of the bodies' angles at a pose (n_q,) from their targets."""
        return np.zeros(0) if self.turning is None else self.turning @ q - self.angles


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SitePose:
    """The pose (n_q,) that comes nearest to the targets, and the `distance_m` of each site and body (n + m,) there."""

    pose: np.ndarray
    distance_m: np.ndarray

    def arrived(self, mechanism: Mechanism) -> bool:
        """Return True if every site and body is at its target."""
        return bool(self.distance_m.max(initial=0.0) <= ARRIVED_SHARE * mechanism.extent_m)


@functools.lru_cache(maxsize=16)
def _kinematics(mechanism: Mechanism) -> ca.Function:
    """Return the function q -> positions of all sites (3 n_sites,), and their Jacobian with respect to q."""
    q = ca.SX.sym("q", mechanism.n_q)
    places = ca.vec(mechanism.dynamics.site_places(q))
    return ca.Function("sites", [q], [places, ca.densify(ca.jacobian(places, q))])


def places_of(mechanism: Mechanism, site: int, q: np.ndarray) -> np.ndarray:
    """Return the world positions (n, 3) [m] of a site at poses q (n, n_q)."""
    return sampled(mechanism.dynamics.site_places, np.atleast_2d(np.asarray(q, dtype=float)))[:, :, site]


def distance_m(mechanism: Mechanism, targets: SiteTargets, pose: np.ndarray) -> np.ndarray:
    """Return the distances [m] of sites (n,), in the prescribed coordinates, and the arcs of bodies (m,) at a pose."""
    places = np.array([places_of(mechanism, int(site), pose)[0] for site in targets.sites]).reshape(-1, 3)
    arcs = mechanism.extent_m * np.abs(targets.beyond(pose))
    return np.concatenate([np.sqrt(np.nansum((places - targets.points) ** 2, axis=1)), arcs])


def site_pose(
    mechanism: Mechanism,
    targets: SiteTargets,
    start: np.ndarray,
    ranges: np.ndarray,
    prefer: Callable[[np.ndarray], bool] = lambda _: True,
) -> SitePose:
    """Return the pose nearest to `start` with all sites at their targets, or else the pose with the least distance.

    Args:
        mechanism: the assembled mechanism.
        targets: the sites and bodies with their targets.
        start: a closed pose (n_q,); the result is on its branch.
        ranges: [low, high] (n_q, 2) of every joint.
        prefer: poses that satisfy this condition come before all others.
    """
    unit = unit_steps(mechanism.independent_joints, mechanism.extent_m)
    found = []
    for pose in _starts(mechanism, np.array(start, dtype=float), ranges):
        end = _descended(mechanism, targets, pose, ranges)
        off = distance_m(mechanism, targets, end)
        away = float(np.linalg.norm((end - start)[mechanism.independent] / unit))
        inside = np.all((end >= ranges[:, 0] - POSITION_ROUNDING) & (end <= ranges[:, 1] + POSITION_ROUNDING))
        there = bool(inside and off.max(initial=0.0) <= ARRIVED_SHARE * mechanism.extent_m)
        order = (not inside, not there, 0.0 if there else float(off.max()), there and not prefer(end), away)
        found.append((order, len(found), SitePose(pose=end, distance_m=off)))
        if order == (False, False, 0.0, False, 0.0):
            break  # the start is the solution
    return min(found, key=lambda item: item[:2])[2]


def independent_rows_of(mechanism: Mechanism, targets: SiteTargets, pose: np.ndarray, ranges: np.ndarray) -> tuple[int, ...]:
    """Return the indices of independent coordinates among the prescribed ones (`SiteTargets.given`) near a pose (n_q,).

    Their number is the rank of their Jacobian, the largest over several nearby poses. A leg at its full length loses
    rank only in that pose. Passive degrees of freedom are left out.
    """
    import scipy

    rows = np.flatnonzero(targets.given)
    best: np.ndarray = np.zeros(0, dtype=int)
    for q in _nearby(mechanism, pose, ranges):
        _, J = _rows(mechanism, targets, q)
        J = J[:, mechanism.actuated]
        if not J.size:
            continue
        factors: Any = scipy.linalg.qr(J.T, mode="economic", pivoting=True)
        _, R, order = factors
        sizes = np.abs(np.diagonal(R))
        rank = int(np.sum(sizes > FILE_ROUNDING_SHARE))
        if rank > len(best):
            best = np.sort(order[:rank])
    return tuple(int(i) for i in rows[best])


def _starts(mechanism: Mechanism, start: np.ndarray, ranges: np.ndarray) -> Iterator[np.ndarray]:
    """Yield closed start poses: the given one, home, and random ones within the ranges and half a turn."""
    independent = mechanism.independent
    for pose in (start, np.array(mechanism.home)):
        inside = _closed(mechanism, np.clip(pose[independent], *ranges[independent].T), pose)
        yield pose if inside is None else inside
    half = np.array([np.pi if mechanism.joints[i].kind == "hinge" else mechanism.extent_m for i in independent])
    s = start[independent]
    low, high = np.maximum(ranges[independent, 0], s - half), np.minimum(ranges[independent, 1], s + half)
    random = np.random.default_rng(20)
    for _ in range(12):
        there = low + (high - low) * random.random(len(s))
        pose = _closed(mechanism, there, start)
        if pose is not None:
            yield pose


def _nearby(mechanism: Mechanism, pose: np.ndarray, ranges: np.ndarray) -> Iterator[np.ndarray]:
    """Yield a pose and up to four random closed poses within 0.05 [rad or extents] of it."""
    yield pose
    independent, random = mechanism.independent, np.random.default_rng(20)
    unit = unit_steps(mechanism.independent_joints, mechanism.extent_m)
    for _ in range(4):
        s = np.clip(pose[independent] + 0.05 * unit * random.uniform(-1, 1, len(unit)), *ranges[independent].T)
        near = _closed(mechanism, s, pose)
        if near is not None:
            yield near


def _rows(mechanism: Mechanism, targets: SiteTargets, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors [extents or rad] of the prescribed coordinates, and their Jacobian by s [rad or extents]."""
    places, J = (np.array(x) for x in _kinematics(mechanism)(q))
    asked = targets.points.ravel()
    at = (3 * targets.sites[:, None] + np.arange(3)).ravel()[~np.isnan(asked)]
    gamma = np.array(mechanism.dynamics.velocity_map(q))
    unit = unit_steps(mechanism.independent_joints, mechanism.extent_m)
    error = (places.ravel()[at] - asked[~np.isnan(asked)]) / mechanism.extent_m
    slope = J[at] @ gamma * unit / mechanism.extent_m
    if targets.turning is None:
        return error, slope
    return np.concatenate([error, targets.beyond(q)]), np.vstack([slope, targets.turning @ gamma * unit])


def _beyond(mechanism: Mechanism, q: np.ndarray, ranges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the weighted range violations of dependent joints, and their Jacobian with respect to s."""
    unit = unit_steps(mechanism.joints, mechanism.extent_m)
    violation = np.maximum(q - ranges[:, 1], 0.0) - np.maximum(ranges[:, 0] - q, 0.0)
    violation[mechanism.independent] = 0.0
    out = np.flatnonzero(violation)
    slope = np.array(mechanism.dynamics.velocity_map(q))[out] * unit[mechanism.independent] / unit[out, None]
    return _RANGE_WEIGHT * violation[out] / unit[out], _RANGE_WEIGHT * slope


def _descended(mechanism: Mechanism, targets: SiteTargets, start: np.ndarray, ranges: np.ndarray) -> np.ndarray:
    """Return the pose at a local minimum of the least squares from a closed start pose."""
    independent = mechanism.independent
    unit = unit_steps(mechanism.independent_joints, mechanism.extent_m)
    low, high = ranges[independent].T / unit

    def residuals(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        parts = _rows(mechanism, targets, q), _beyond(mechanism, q, ranges)
        return np.concatenate([part[0] for part in parts]), np.vstack([part[1] for part in parts])

    q, damping = start, 1e-3
    r, J = residuals(q)
    for _ in range(150):
        s = np.clip(q[independent] / unit, low, high)
        step = _step(J, r, damping, np.maximum(low - s, -_MAX_STEP), np.minimum(high - s, _MAX_STEP))
        if np.abs(step).max(initial=0.0) < _CONVERGED_STEP or r @ r == 0.0:
            break
        trial = _closed(mechanism, (s + step) * unit, q)
        further = None if trial is None else residuals(trial)
        if trial is not None and further is not None and further[0] @ further[0] < r @ r:
            gained = 1 - further[0] @ further[0] / (r @ r)
            q, (r, J), damping = trial, further, max(damping / 10, 1e-14)
            if gained < _CONVERGED_STEP:
                break
        else:
            damping *= 10
            if damping > 1e12:
                break
    return q


def _step(J: np.ndarray, r: np.ndarray, damping: float, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the step d (n_s,) within [low, high] at which |r + J d|^2 + damping |d|^2 is least."""
    import scipy

    stacked = np.vstack([J, np.sqrt(damping) * np.eye(len(low))])
    right = np.concatenate([-r, np.zeros(len(low))])
    step = np.linalg.lstsq(stacked, right, rcond=None)[0]
    if np.all((low <= step) & (step <= high)):
        return step
    # The active-set method is exact, and for a few coordinates it is ten times as fast as the interior-point method.
    bounded = scipy.optimize.lsq_linear(stacked, right, (low, high), method="bvls", max_iter=100 * len(low))
    return np.asarray(bounded.x)


def _closed(mechanism: Mechanism, s: np.ndarray, near: np.ndarray) -> np.ndarray | None:
    """Return the pose (n_q,) at positions s (n_s,) on the branch of the closed pose `near`, or None if a loop opens."""
    if not len(mechanism.dependent):  # an open tree needs no continuation
        pose = np.array(near, dtype=float)
        pose[mechanism.independent] = s
        return None if mechanism.coordinates.range_violation(pose) is not None else pose
    try:
        return close_at(mechanism, s, near)
    except AssemblyError:
        return None
