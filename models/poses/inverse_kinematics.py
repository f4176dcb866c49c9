"""Inverse kinematics: poses on the assembled branch in which sites stand where they are asked to.

Levenberg-Marquardt in the independent positions s, the loops closed at every step (Nocedal & Wright, Numerical
Optimization, 10.3): least squares of the sites' distances, independent ranges as bounds of the step, dependent ranges as
steep penalties. Several starts, the same in every run; of the poses that they lead to, the one nearest to where they began.
"""

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled
from linkplan.models.poses.assembly import close_at

# Sites within this share of the mechanism's extent of where they are asked are there.
ARRIVED = 1e-9
# Starts beside the first, drawn at random with this seed, and the iterations from each.
_STARTS, _SEED, _ITERATIONS = 12, 20, 150
# No step is longer than this [rad, or shares of the extent]; shorter than the other it has converged.
_STEP, _CONVERGED = 0.5, 1e-14
# Squared distances that a step makes smaller by less than this share are the least: out of reach they stay above zero.
_NO_GAIN = 1e-14
# A dependent joint beyond its range weighs so much more than a site away from its place.
_STOP = 1e3
# Joints are within their ranges but for this [rad or m].
_SLACK = 1e-9
# Singular values below this share of the largest are none, at any of so many poses about the one that is looked at.
_RANK, _ABOUT, _AWAY = 1e-6, 4, 0.05


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SiteTargets:
    """Where sites are asked to be: their indices (n,) in the model, and points (n, 3) [m] in the world, NaN where free."""

    sites: np.ndarray
    points: np.ndarray

    @property
    def given(self) -> np.ndarray:
        """Which of the sites' coordinates (3 n,), one after another, are asked for."""
        return ~np.isnan(self.points.ravel())


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SitePose:
    """The pose (n_q,) that comes nearest to what sites are asked, and how far off each of them (n,) [m] is there."""

    pose: np.ndarray
    off_m: np.ndarray

    def arrived(self, mechanism: Mechanism) -> bool:
        """Return True if every site is where it is asked to be."""
        return bool(self.off_m.max(initial=0.0) <= ARRIVED * mechanism.extent_m)


@functools.lru_cache(maxsize=16)
def _kinematics(mechanism: Mechanism) -> ca.Function:
    """Return the function q -> places of all sites, one after another (3 n_sites,), and their Jacobian by q."""
    q = ca.SX.sym("q", mechanism.n_q)
    places = ca.vec(mechanism.dynamics.site_places(q))
    return ca.Function("sites", [q], [places, ca.densify(ca.jacobian(places, q))])


def places_of(mechanism: Mechanism, site: int, q: np.ndarray) -> np.ndarray:
    """Return the world positions (n, 3) [m] of a site at poses q (n, n_q)."""
    return sampled(mechanism.dynamics.site_places, np.atleast_2d(np.asarray(q, dtype=float)))[:, :, site]


def off_m(mechanism: Mechanism, targets: SiteTargets, pose: np.ndarray) -> np.ndarray:
    """Return how far (n,) [m] sites are from where they are asked, in the coordinates asked, at a pose (n_q,)."""
    places = np.array([places_of(mechanism, int(site), pose)[0] for site in targets.sites])
    return np.sqrt(np.nansum((places - targets.points) ** 2, axis=1))


def site_pose(
    mechanism: Mechanism,
    targets: SiteTargets,
    start: np.ndarray,
    ranges: np.ndarray,
    prefer: Callable[[np.ndarray], bool] = lambda _: True,
) -> SitePose:
    """Return the pose in which sites stand where they are asked, nearest to where it began; else the one that comes nearest.

    Args:
        mechanism: whose sites they are.
        targets: what is asked of them.
        start: a closed pose (n_q,), on whose branch the answer is.
        ranges: [low, high] (n_q, 2) of every joint.
        prefer: poses for which this is false are taken where there are no others.
    """
    unit = np.array([1.0 if j.kind == "hinge" else mechanism.extent_m for j in mechanism.joints])[mechanism.independent]
    found = []
    for pose in _starts(mechanism, np.array(start, dtype=float), ranges):
        end = _descended(mechanism, targets, pose, ranges)
        off = off_m(mechanism, targets, end)
        away = float(np.linalg.norm((end - start)[mechanism.independent] / unit))
        inside = np.all((end >= ranges[:, 0] - _SLACK) & (end <= ranges[:, 1] + _SLACK))
        there = bool(inside and off.max(initial=0.0) <= ARRIVED * mechanism.extent_m)
        order = (not inside, not there, 0.0 if there else float(off.max()), there and not prefer(end), away)
        found.append((order, len(found), SitePose(pose=end, off_m=off)))
        if order == (False, False, 0.0, False, 0.0):
            break  # it is there already
    return min(found, key=lambda item: item[:2])[2]


def independent_rows_of(mechanism: Mechanism, targets: SiteTargets, pose: np.ndarray, ranges: np.ndarray) -> tuple[int, ...]:
    """Return which of the sites' coordinates, counted as in `SiteTargets.given`, say all that is asked near a pose (n_q,).

    Their number is the rank of what is asked, the largest of several poses about it: a leg stretched out to its full length
    loses rank in that pose alone. Passive degrees of freedom count for nothing.
    """
    import scipy

    rows = np.flatnonzero(targets.given)
    best: np.ndarray = np.zeros(0, dtype=int)
    for q in _about(mechanism, pose, ranges):
        _, J = _rows(mechanism, targets, q)
        J = J[:, ~np.isin(mechanism.independent, mechanism.passive_dofs)]
        if not J.size:
            continue
        factors: Any = scipy.linalg.qr(J.T, mode="economic", pivoting=True)
        _, R, order = factors
        sizes = np.abs(np.diagonal(R))
        rank = int(np.sum(sizes > _RANK))
        if rank > len(best):
            best = np.sort(order[:rank])
    return tuple(int(i) for i in rows[best])


def _starts(mechanism: Mechanism, start: np.ndarray, ranges: np.ndarray) -> Iterator[np.ndarray]:
    """Yield closed poses to begin from: the first, home, and such at random within the ranges, a half turn at the most."""
    independent = mechanism.independent
    for pose in (start, np.array(mechanism.home)):
        inside = _closed(mechanism, np.clip(pose[independent], *ranges[independent].T), pose)
        yield pose if inside is None else inside
    half = np.array([np.pi if mechanism.joints[i].kind == "hinge" else mechanism.extent_m for i in independent])
    s = start[independent]
    low, high = np.maximum(ranges[independent, 0], s - half), np.minimum(ranges[independent, 1], s + half)
    random = np.random.default_rng(_SEED)
    for _ in range(_STARTS):
        there = low + (high - low) * random.random(len(s))
        pose = _closed(mechanism, there, start)
        if pose is not None:
            yield pose


def _about(mechanism: Mechanism, pose: np.ndarray, ranges: np.ndarray) -> Iterator[np.ndarray]:
    """Yield a pose and some closed ones near it."""
    yield pose
    independent, random = mechanism.independent, np.random.default_rng(_SEED)
    unit = np.array([1.0 if mechanism.joints[i].kind == "hinge" else mechanism.extent_m for i in independent])
    for _ in range(_ABOUT):
        s = np.clip(pose[independent] + _AWAY * unit * random.uniform(-1, 1, len(unit)), *ranges[independent].T)
        near = _closed(mechanism, s, pose)
        if near is not None:
            yield near


def _rows(mechanism: Mechanism, targets: SiteTargets, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what the sites' asked coordinates are off by, and its slope by s, in extents by radians or extents."""
    places, J = (np.array(x) for x in _kinematics(mechanism)(q))
    at = (3 * targets.sites[:, None] + np.arange(3)).ravel()[targets.given]
    unit = np.array([1.0 if mechanism.joints[i].kind == "hinge" else mechanism.extent_m for i in mechanism.independent])
    slope = J[at] @ np.array(mechanism.dynamics.velocity_map(q)) * unit / mechanism.extent_m
    return (places.ravel()[at] - targets.points.ravel()[targets.given]) / mechanism.extent_m, slope


def _beyond(mechanism: Mechanism, q: np.ndarray, ranges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return by how much dependent joints are beyond their ranges, as residuals with their slope by s."""
    unit = np.array([1.0 if joint.kind == "hinge" else mechanism.extent_m for joint in mechanism.joints])
    over = np.maximum(q - ranges[:, 1], 0.0) - np.maximum(ranges[:, 0] - q, 0.0)
    over[mechanism.independent] = 0.0
    out = np.flatnonzero(over)
    slope = np.array(mechanism.dynamics.velocity_map(q))[out] * unit[mechanism.independent] / unit[out, None]
    return _STOP * over[out] / unit[out], _STOP * slope


def _descended(mechanism: Mechanism, targets: SiteTargets, start: np.ndarray, ranges: np.ndarray) -> np.ndarray:
    """Return the pose that least squares lead to from a closed one."""
    independent = mechanism.independent
    unit = np.array([1.0 if mechanism.joints[i].kind == "hinge" else mechanism.extent_m for i in independent])
    low, high = ranges[independent].T / unit

    def residuals(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        parts = _rows(mechanism, targets, q), _beyond(mechanism, q, ranges)
        return np.concatenate([part[0] for part in parts]), np.vstack([part[1] for part in parts])

    q, damping = start, 1e-3
    r, J = residuals(q)
    for _ in range(_ITERATIONS):
        s = np.clip(q[independent] / unit, low, high)
        step = _step(J, r, damping, np.maximum(low - s, -_STEP), np.minimum(high - s, _STEP))
        if np.abs(step).max(initial=0.0) < _CONVERGED or r @ r == 0.0:
            break
        trial = _closed(mechanism, (s + step) * unit, q)
        further = None if trial is None else residuals(trial)
        if trial is not None and further is not None and further[0] @ further[0] < r @ r:
            gained = 1 - further[0] @ further[0] / (r @ r)
            q, (r, J), damping = trial, further, max(damping / 10, 1e-14)
            if gained < _NO_GAIN:
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
    wanted = np.concatenate([-r, np.zeros(len(low))])
    step = np.linalg.lstsq(stacked, wanted, rcond=None)[0]
    if np.all((low <= step) & (step <= high)):
        return step
    return np.asarray(scipy.optimize.lsq_linear(stacked, wanted, bounds=(low, high)).x)


def _closed(mechanism: Mechanism, s: np.ndarray, near: np.ndarray) -> np.ndarray | None:
    """Return the pose (n_q,) at positions s (n_s,) on the branch of a closed one; None where the loops do not close."""
    if not len(mechanism.dependent):  # nothing to follow: an open tree is closed anywhere
        pose = np.array(near, dtype=float)
        pose[mechanism.independent] = s
        return None if mechanism.coordinates.range_violation(pose) is not None else pose
    try:
        return close_at(mechanism, s, near)
    except AssemblyError:
        return None
