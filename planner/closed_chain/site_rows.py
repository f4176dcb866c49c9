"""Sites in the program: rows that keep them where they stay, waypoints and the end of a motion that leave their pose open.

A slab's row is n . (p - p_home) / L, L the mechanism's extent. A tube's is d^2 / r^2, d the distance from the polyline:
least over its segments, a kink for a solver. In place of the least stands the mean with the weights exp(-k d_i^2 / r^2),
which is smooth and never below it: what keeps to it keeps to the tube.
"""

import itertools

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.problem.sites import SiteLimit
from linkplan.planner.transcription.system import Endpoint

# Where two segments are nearly as far, the mean of squared distances is above the least by 0.28 / k of r^2 at the most: k
# this large takes 0.14 % off a tube's radius there, and the bend of its wall stays of the order of 1 / r.
_SHARPNESS = 100.0
# How many parts a tube's key has: site, polyline, radius. A slab's has site and normal.
TUBE = 3


def site_row(mechanism: Mechanism, key: tuple, q: ca.SX) -> ca.SX:
    """Return the row of a limit on a site, by `SiteLimit.key`, at the pose q (n_q,)."""
    p = mechanism.dynamics.site_places(q)[:, key[0]]
    if len(key) == TUBE:
        return _tube(p, np.array(key[1]), key[2])
    normal = np.array(key[1])
    return (ca.dot(ca.DM(normal), p) - float(normal @ _home(mechanism, key[0]))) / mechanism.extent_m


def site_bounds(mechanism: Mechanism, limit: SiteLimit) -> tuple[float, float]:
    """Return the bounds of a limit's row."""
    if limit.is_tube:
        return -np.inf, (limit.high / limit.scale) ** 2
    off = limit.origin - float(limit.normal @ _home(mechanism, limit.index))
    return (limit.low + off) / mechanism.extent_m, (limit.high + off) / mechanism.extent_m


def coordinate_key(site: int, axis: int) -> tuple:
    """Return the key of the row of a site's coordinate, as of `SiteLimit.key`."""
    return site, tuple(np.eye(3)[axis].tolist())


def coordinate_row(mechanism: Mechanism, site: int, axis: int, value: float) -> float:
    """Return what the row of a site's coordinate is where that is `value` [m]."""
    return float(value - _home(mechanism, site)[axis]) / mechanism.extent_m


def site_endpoint(problem: PlanningProblem, unit: np.ndarray, n_z: int) -> tuple[Endpoint | None, np.ndarray]:
    """Return what is asked of the end of a motion with an open pose, and its parameters: the sites' coordinates [m].

    None and no parameters where the pose at the end is given.

    Args:
        problem: of the motion.
        unit: of the independent positions (n_s,) [rad or m].
        n_z: the number of algebraic unknowns, of which the dependent joints are the first.
    """
    mechanism, motion = problem.mechanism, problem.motion
    if not motion.goal_is_free:
        return None, np.zeros(0)
    n_s, n_dependent = mechanism.dof, len(mechanism.dependent)
    first, last, lasts = (ca.SX.sym(name, size) for name, size in (("first", 2 * n_s), ("last", 2 * n_s), ("lasts", 1)))
    asked = ca.SX.sym("asked", len(motion.goal_rows))
    z = ca.SX.sym("z", n_z)
    order = np.argsort(np.concatenate([mechanism.independent, mechanism.dependent]))
    q = ca.vertcat(last[:n_s] * ca.DM(unit), z[:n_dependent])[[int(i) for i in order]]
    places = mechanism.dynamics.site_places(q)
    at = ca.vertcat(*[places[:, point.index] for point in motion.goal_at])[list(motion.goal_rows)]
    column = ca.vertcat((at - asked) / mechanism.extent_m, 0.0)
    inputs = [first, last, lasts, asked, *([z] if n_dependent else [])]
    points = np.concatenate([point.point for point in motion.goal_at])[list(motion.goal_rows)]
    function = ca.Function("site_end", inputs, [column])
    return Endpoint(function=function, n_rows=len(motion.goal_rows), algebraic=bool(n_dependent)), points


def _home(mechanism: Mechanism, site: int) -> np.ndarray:
    """Return where a site is at home (3,) [m]."""
    return places_of(mechanism, site, mechanism.home)[0]


def _tube(p: ca.SX, along: np.ndarray, radius: float) -> ca.SX:
    """Return the squared distance of p (3,) from a polyline (n, 3), in squared radii, smooth and never too small."""
    distances = []
    for a, b in itertools.pairwise(along):
        way = b - a
        share = ca.fmax(0.0, ca.fmin(1.0, ca.dot(p - ca.DM(a), ca.DM(way)) / float(way @ way)))
        off = p - ca.DM(a) - share * ca.DM(way)
        distances.append(ca.sumsqr(off) / radius**2)
    squares = ca.vertcat(*distances)
    weights = ca.exp(-_SHARPNESS * (squares - ca.mmin(squares)))
    return ca.dot(weights, squares) / ca.sum1(weights)
