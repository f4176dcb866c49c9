"""Limits on sites and bodies: a coordinate or a distance from a wall between bounds, or the distance from a polyline.

A slab's row is n . (p - p_home) / L with the mechanism's extent L. A tube's row is d^2 / r^2 with the distance d from the
polyline. The least distance over the segments has kinks, so the row uses a mean with the weights exp(-k d_i^2 / r^2), which
is smooth and never below the least distance. A motion that satisfies the row therefore stays in the tube.

The row of a limit on the angle of a body is the angle relative to home [rad]. The angle is linear in the joints' positions
(`linkplan.models.poses.body_angles`), so it can also limit a joint that appears in no other limit.
"""

import functools
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.body_angles import turning
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.planner.limits.joints import RANGE_SLACK
from linkplan.planner.limits.limit import Bounds, Claimed, Limit, LimitFacts, Measured, Rows, Tightened, with_limits
from linkplan.planner.limits.samples import Poses, Samples
from linkplan.planner.problem.instant import Instant, Scales
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.sites import ANGLE, AXES, BodyAngle, SiteLimit, SitePoint, Task, angles_of
from linkplan.planner.trajectory import Trajectory

# Between two segments at nearly equal distances, the weighted mean exceeds the least squared distance by at most 0.28 / k of
# r^2. This k reduces a tube's radius there by 0.14 %, and the curvature of its wall stays of the order of 1 / r.
_TUBE_SHARPNESS = 100.0


_SLAB = LimitFacts(kind="site", tightened=Tightened.IN_UNITS, of_position=True, by_size=True)
_TUBE = replace(_SLAB, kind="tube", tightened=Tightened.SQUARED)


@dataclass(frozen=True, slots=True)
class SitePathLimit(Limit):
    """One limit on a site, number `item` of limits.site; `shape` is its `SiteLimit.key`, which determines its row."""

    key: ClassVar[str] = "site"
    item: int
    shape: tuple

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        return [cls(item, limit.key) for item, limit in enumerate(problem.limits.site)]

    @property
    def is_tube(self) -> bool:
        return len(self.shape) == 3

    @property
    def facts(self) -> LimitFacts:
        return _TUBE if self.is_tube else _SLAB

    @property
    def rows(self) -> Rows:
        def node(at: Instant, _: ca.SX) -> ca.SX:
            if self.is_tube:
                return _tube(at.of_pose("site_places")[:, self.shape[0]], np.array(self.shape[1]), self.shape[2])
            return way(at, self.shape[0], np.array(self.shape[1]))

        return Rows(node=node)

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        limit, mechanism = problem.limits.site[self.item], problem.mechanism
        if self.is_tube:
            return -np.inf, (limit.high / limit.scale) ** 2
        off = limit.origin - float(limit.normal @ site_at_home(mechanism, limit.index))
        return (limit.low + off) / mechanism.extent_m, (limit.high + off) / mechanism.extent_m

    def measured(self, at: Poses) -> Measured:
        mechanism, limit = at.problem.mechanism, at.problem.limits.site[self.item]
        # A tube's distance has no lower bound. A slab's overruns are shares of the mechanism's extent.
        bounds, size = ((-np.inf, limit.high), limit.high) if self.is_tube else ((limit.low, limit.high), mechanism.extent_m)

        def values(q: np.ndarray) -> np.ndarray:
            return limit.value(places_of(mechanism, limit.index, q))

        def at_times(time: np.ndarray) -> np.ndarray:
            motion, until = at.trajectory, at.problem.solver.judging_deadline
            return values(follow(mechanism, motion.position_at(time), motion.start_pose, until))

        def known_from(tasks: Sequence[Task]) -> bool:
            looked_at = np.ones(3, dtype=bool) if limit.normal is None else limit.normal != 0
            points = [task for task in tasks if isinstance(task, SitePoint) and task.index == limit.index]
            return any(not np.any(np.isnan(p.point[looked_at])) for p in points)

        return Measured(
            site_title(limit),
            values(at.q),
            bounds,
            "m",
            size,
            # Between two segments a tube's distance has a kink, which parabolas do not fit.
            at_times=at_times if isinstance(at, Samples) else None,
            pose_size=mechanism.extent_m,
            known_from=known_from,
        )

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        mechanism, limit = problem.mechanism, problem.limits.site[self.item]
        q = ca.SX.sym("q", mechanism.n_q)
        place = mechanism.dynamics.site_places(q)[:, limit.index]
        bounds, slack = (limit.low, limit.high), None
        if limit.is_tube:
            value, squared = functools.reduce(ca.fmin, squared_distances(place, np.asarray(limit.along))), limit.high**2
            slack = (0.0, (limit.high + ROUNDING_SHARE * max(1.0, limit.high)) ** 2 - squared)
            name, unit, bounds = f"squared distance from the tube of site {limit.site}", "m2", (-np.inf, squared)
        else:
            value = ca.dot(ca.DM(np.asarray(limit.normal)), place) - limit.origin
            name, unit = f"{limit.what} of site {limit.site}", "m"
        function = ca.Function("site", [q], [ca.densify(value)])
        yield Claimed(name=name, unit=unit, bounds=bounds, value=function, of_planned=True, slack=slack)

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        if not np.isfinite(factor):
            return with_limits(problem, site=())
        room_m = (factor - 1) * problem.mechanism.extent_m
        wider = tuple(
            replace(one, high=one.high * factor)
            if one.is_tube
            else replace(one, low=one.low - room_m, high=one.high + room_m)
            for one in problem.limits.site
        )
        return with_limits(problem, site=wider)


def way(at: Instant, site: int, normal: np.ndarray) -> ca.SX:
    """Return the displacement of a site from home along a direction, in extents of the mechanism."""
    p, home = at.of_pose("site_places")[:, site], site_at_home(at.mechanism, site)
    return (ca.dot(ca.DM(normal), p) - float(normal @ home)) / at.mechanism.extent_m


def site_title(limit: SiteLimit) -> str:
    """Return a phrase for the limited quantity of a site."""
    from_what = {"wall": "its wall", "tube": "its path"}.get(limit.what)
    return (
        f"{limit.what} of site {limit.site}" if from_what is None else f"the distance of site {limit.site} from {from_what}"
    )


def site_at_home(mechanism: Mechanism, site: int) -> np.ndarray:
    """Return the place of a site at home (3,) [m]."""
    return places_of(mechanism, site, mechanism.home)[0]


def _tube(p: ca.SX, along: np.ndarray, radius: float) -> ca.SX:
    """Return the squared distance of p (3,) from a polyline (n, 3), in squared radii; smooth, and never too small."""
    squares = ca.vertcat(*squared_distances(p, along)) / radius**2
    weights = ca.exp(-_TUBE_SHARPNESS * (squares - ca.mmin(squares)))
    return ca.dot(weights, squares) / ca.sum1(weights)


def squared_distances(p: ca.SX, along: np.ndarray) -> list[ca.SX]:
    """Return the squared distances [m2] of a place p (3,) from the segments of a polyline (n, 3)."""

    def from_segment(a: np.ndarray, b: np.ndarray) -> ca.SX:
        way, off = b - a, p - ca.DM(a)
        share = ca.fmax(0.0, ca.fmin(1.0, ca.dot(off, ca.DM(way)) / float(way @ way)))
        return ca.sumsqr(off - share * ca.DM(way))

    return [from_segment(a, b) for a, b in itertools.pairwise(along)]


# Overruns are shares of one radian [deg].
_RADIAN_DEG = float(np.degrees(1.0))


@dataclass(frozen=True, slots=True)
class BodyAngleLimit(Limit):
    """The limit on the angle of one body, number `item` of limits.body_deg; `body` is its index in the model."""

    key: ClassVar[str] = "body"
    facts: ClassVar[LimitFacts] = LimitFacts(
        kind=key, words="the angle of body {}", tightened=Tightened.IN_UNITS, of_position=True, by_size=True
    )
    item: int
    body: int

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        limits = enumerate(problem.limits.body)
        return [cls(item, limit.index) for item, limit in limits if np.isfinite([limit.low, limit.high]).any()]

    @property
    def rows(self) -> Rows:
        return Rows(node=lambda at, _: coordinate(at, self.body, ANGLE))

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        limit = problem.limits.body[self.item]
        low, high = (scaled_coordinate(problem.mechanism, self.body, ANGLE, end) for end in (limit.low, limit.high))
        return low, high

    def measured(self, at: Poses) -> Measured:
        limit = at.problem.limits.body[self.item]
        angles, bounds = np.degrees(limit.at_poses(at.problem.mechanism, at.q)), np.degrees([limit.low, limit.high])

        def known_from(tasks: Sequence[Task]) -> bool:
            return any(isinstance(task, BodyAngle) and task.index == limit.index for task in tasks)

        return Measured(limit.body, angles, bounds, "deg", _RADIAN_DEG, known_from=known_from)

    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        limit, q = problem.limits.body[self.item], ca.SX.sym("q", problem.mechanism.n_q)
        yield Claimed(
            name=f"angle of body {limit.body}",
            unit="deg",
            bounds=(limit.low, limit.high),
            value=ca.Function("angle", [q], [ca.densify(expression_of(problem.mechanism, self.body, ANGLE, q))]),
            of_planned=True,
            slack=(RANGE_SLACK, RANGE_SLACK),
            per_unit=_RADIAN_DEG,
        )

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        room = factor - 1  # of one radian
        wider = tuple(replace(one, low=one.low - room, high=one.high + room) for one in problem.limits.body)
        return with_limits(problem, body=wider)


def coordinate(at: Instant, index: int, axis: int) -> ca.SX:
    """Return the displacement from home of a site along an axis of the world [extents], or of a body's angle [rad]."""
    if axis == ANGLE:
        return expression_of(at.mechanism, index, axis, at.q) - _home(at.mechanism, index, axis)
    return way(at, index, np.eye(len(AXES))[axis])


def scaled_coordinate(mechanism: Mechanism, index: int, axis: int, value: float) -> float:
    """Return the value of `coordinate` at a coordinate [m or rad]."""
    return (value - _home(mechanism, index, axis)) / unit_of(mechanism, axis)


def expression_of(mechanism: Mechanism, index: int, axis: int, q: ca.SX) -> ca.SX:
    """Return a coordinate [m or rad] at a pose q (n_q,)."""
    if axis == ANGLE:
        return ca.dot(ca.DM(turning(mechanism, index, "the angle")), q)
    return mechanism.dynamics.site_places(q)[axis, index]


def unit_of(mechanism: Mechanism, axis: int) -> float:
    """Return the unit of a coordinate in the program: the mechanism's extent [m], or one radian."""
    return 1.0 if axis == ANGLE else mechanism.extent_m


def _home(mechanism: Mechanism, index: int, axis: int) -> float:
    """Return a coordinate [m or rad] at home."""
    if axis == ANGLE:
        return float(angles_of(mechanism, index, mechanism.home)[0])
    return float(site_at_home(mechanism, index)[axis])
