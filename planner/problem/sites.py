"""Tasks in space: points and angles at which sites and bodies start or end, and regions within which they stay.

Each limit is on one quantity of a site at p (3,) [m] in the world's frame: n . p for a box's coordinate (n an axis) and for
a wall (n its normal), or the distance from a polyline for a tube. A limit on a body is on its angle
(`linkplan.models.poses.body_angles`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.body_angles import body_index, turning
from linkplan.models.poses.inverse_kinematics import SiteTargets, independent_rows_of, places_of, site_pose
from linkplan.models.tree.dynamics import site_index
from linkplan.planner.problem.keys.limits import SITE_LIMITS, Box, Tube, Wall
from linkplan.planner.problem.keys.reading import read
from linkplan.planner.problem.settings import frozen, interval

AXES = Box.__struct_fields__
# The place of a body's angle among the coordinates of a task, after the three axes of sites.
ANGLE = len(AXES)
# A coordinate of a task: the index of a site, or of a body; its axis, or ANGLE; and its value [m or rad].
Coordinate = tuple[int, int, float]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SiteLimit:
    """A limit on a site at every instant: a slab low <= n . p <= high [m], or a tube around a polyline.

    Args:
        site: the site's name; `index` is its index in the model.
        what: "x", "y", "z", "wall" or "tube"; `name` adds the site's name, and a number if there are several.
        normal: unit vector n (3,) of a slab; None for a tube.
        low, high: bounds [m]; 0 and the radius for a tube.
        along: the polyline's corners (n, 3) [m]; None for a slab.
        scale: the radius [m] in a tube's row; its own radius by default.
        origin: n . p [m] at which a wall's distance is zero; 0 for a coordinate.
    """

    site: str
    index: int
    what: str
    name: str
    low: float
    high: float
    normal: np.ndarray | None = None
    along: np.ndarray | None = None
    scale: float | None = None
    origin: float = 0.0

    def __post_init__(self) -> None:
        if self.scale is None:
            object.__setattr__(self, "scale", self.high)
        for field in ("normal", "along"):
            value = getattr(self, field)
            if value is not None:
                object.__setattr__(self, field, frozen(value))

    @property
    def is_tube(self) -> bool:
        """Whether it is a tube and not a slab."""
        return self.along is not None

    def value(self, p: np.ndarray) -> np.ndarray:
        """Return the limited quantity (n,) [m] at points (n, 3): a coordinate, or the distance from a wall or polyline."""
        p = np.asarray(p, dtype=float)
        if self.along is None:
            return p @ self.normal - self.origin
        return np.sqrt(
            np.min(np.stack([_squared(p, a, b) for a, b in zip(self.along, self.along[1:], strict=False)]), axis=0)
        )

    def at_poses(self, mechanism: Mechanism, q: np.ndarray) -> np.ndarray:
        """Return the limited quantity (n,) [m] at poses q (n, n_q)."""
        return self.value(places_of(mechanism, self.index, q))

    @property
    def key(self) -> tuple:
        """The identity of its row in a program, without the bounds: equal keys have equal rows."""
        if self.along is None:
            return self.index, tuple(self.normal.tolist())
        return self.index, tuple(map(tuple, self.along.tolist())), self.scale


def _squared(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the squared distance (n,) of points (n, 3) from the segment a-b."""
    way = b - a
    share = np.clip((p - a) @ way / (way @ way), 0.0, 1.0)
    return np.sum((p - a - share[:, None] * way) ** 2, axis=1)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SitePoint:
    """The place of a site at a motion's start or end: `point` (3,) [m] in the world, NaN where a coordinate is free."""

    site: str
    index: int
    point: np.ndarray

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", frozen(self.point))

    @property
    def label(self) -> str:
        """Its name in messages."""
        return f"site {self.site}"

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Its coordinates in the program, NaN where free."""
        return tuple((self.index, axis, float(x)) for axis, x in enumerate(self.point))

    def distance_m(self, p: np.ndarray) -> float:
        """Return the distance [m] of a place p (3,) from the point, in the prescribed coordinates."""
        return float(np.sqrt(np.nansum((np.asarray(p) - self.point) ** 2)))

    def off_m(self, mechanism: Mechanism, q: np.ndarray) -> np.ndarray:
        """Return the distances (n,) [m] of the site from the point at poses q (n, n_q)."""
        return np.array([self.distance_m(p) for p in places_of(mechanism, self.index, q)])


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class BodyAngle:
    """The angle [rad] of a body at a motion's start or end; its error is the arc [m] at the mechanism's extent."""

    body: str
    index: int
    angle_rad: float

    @property
    def label(self) -> str:
        """Its name in messages."""
        return f"body {self.body}"

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Its coordinate in the program."""
        return ((self.index, ANGLE, self.angle_rad),)

    def off_m(self, mechanism: Mechanism, q: np.ndarray) -> np.ndarray:
        """Return the arcs (n,) [m] of the body from the angle at poses q (n, n_q)."""
        return mechanism.extent_m * np.abs(angles_of(mechanism, self.index, q) - self.angle_rad)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class BodyLimit:
    """A limit on the angle of a body at every instant, low <= angle <= high [rad]; infinite ends limit nothing."""

    body: str
    index: int
    low: float
    high: float

    def at_poses(self, mechanism: Mechanism, q: np.ndarray) -> np.ndarray:
        """Return the limited angle (n,) [rad] at poses q (n, n_q)."""
        return angles_of(mechanism, self.index, q)


Task = SitePoint | BodyAngle


def angles_of(mechanism: Mechanism, body: int, q: np.ndarray) -> np.ndarray:
    """Return the angles (n,) [rad] of a body at poses q (n, n_q)."""
    return np.atleast_2d(q) @ turning(mechanism, body, "the angle", ProblemError)


# A normal, or a segment of a polyline, below this length [1 or m] has no direction.
_MIN_LENGTH = 1e-9


def tasks_of(
    places: Mapping[str, list | dict], angles: Mapping[str, float], where: str, mechanism: Mechanism
) -> tuple[Task, ...]:
    """Return prescribed places of sites and angles of bodies.

    Args:
        places: by site, such as { foot = [x, y, z] } or { foot = { z = 0.2 } }.
        angles: by body [deg].
        where: their keys, with {} for "at" or "body_deg".
        mechanism: the mechanism.

    Raises:
        ProblemError: for an unknown site or body, or a body without a single angle.
    """
    found: list[Task] = []
    for name, value in places.items():
        point = [value.get(axis, np.nan) for axis in AXES] if isinstance(value, dict) else value
        index = site_index(mechanism.model, name, where.format("at"), ProblemError)
        found.append(SitePoint(site=name, index=index, point=np.array(point)))
    for name, angle in angles.items():
        index = turning_body(name, where.format("body_deg"), mechanism)
        found.append(BodyAngle(body=name, index=index, angle_rad=float(np.radians(angle))))
    return tuple(found)


def turning_body(name: str, where: str, mechanism: Mechanism) -> int:
    """Return the index of a body with a single angle.

    Raises:
        ProblemError: for an unknown body, or one that does not turn, or turns about several axes.
    """
    index = body_index(mechanism.model, name, where, ProblemError)
    turning(mechanism, index, where, ProblemError)
    return index


def key_of(tasks: Sequence[Task], where: str) -> str:
    """Return the key of the first of some tasks; `where` is that of `tasks_of`."""
    return where.format("at" if isinstance(tasks[0], SitePoint) else "body_deg")


def coordinates_of(tasks: Sequence[Task]) -> tuple[Coordinate, ...]:
    """Return the coordinates of tasks one after another; `Motion.goal_rows` are indices among them."""
    return tuple(coordinate for task in tasks for coordinate in task.coordinates)


def task_words(tasks: Sequence[Task]) -> str:
    """Return "sites", "bodies" or both as text."""
    kinds = [type(task) for task in tasks]
    return " and ".join(word for word, of in (("sites", SitePoint), ("bodies", BodyAngle)) if of in kinds)


def pose_at(
    points: tuple[Task, ...],
    where: str,
    mechanism: Mechanism,
    ranges: np.ndarray,
    limits: Sequence[SiteLimit | BodyLimit],
    begin: np.ndarray,
) -> tuple[np.ndarray, tuple[int, ...]]:
    """Return the positions (n_s,) of the pose nearest to `begin` with sites and bodies as asked, and `Motion.goal_rows`.

    Args:
        points: the sites' places, then the bodies' angles.
        where: their keys, as for `tasks_of`.
        mechanism: the mechanism.
        ranges: of all joints (n_q, 2), which the pose satisfies.
        limits: on sites and bodies, which the pose satisfies if possible.
        begin: a closed pose (n_q,), the start of the search.

    Raises:
        ProblemError: if no such pose is found, with the nearest place and its distance.
    """
    sites, bodies = ([p for p in points if isinstance(p, of)] for of in (SitePoint, BodyAngle))
    targets = SiteTargets(
        sites=np.array([p.index for p in sites], dtype=int),
        points=np.array([p.point for p in sites]).reshape(-1, 3),
        turning=np.array([turning(mechanism, p.index, where, ProblemError) for p in bodies]) if bodies else None,
        angles=np.array([p.angle_rad for p in bodies]),
    )

    def within(q: np.ndarray) -> bool:
        return all(limit.low <= float(limit.at_poses(mechanism, q)[0]) <= limit.high for limit in limits)

    found = site_pose(mechanism, targets, begin, ranges, within)
    if not found.arrived(mechanism):
        worst = points[int(np.argmax(found.distance_m))]
        together = f" together with the other {task_words(points)}" if len(points) > 1 else ""
        raise ProblemError(_out_of_reach(mechanism, worst, key_of([worst], where), together, found.pose))
    rows = independent_rows_of(mechanism, targets, found.pose, ranges)
    active = int(np.sum(mechanism.actuated))
    if not rows:
        raise ProblemError(
            f"{key_of(points, where)} has no effect: the named coordinates of"
            f" {', '.join(p.label.partition(' ')[2] for p in points)} cannot move"
        )
    s = found.pose[mechanism.independent]
    return s, rows if len(rows) < active else ()


def _out_of_reach(mechanism: Mechanism, worst: Task, where: str, together: str, pose: np.ndarray) -> str:
    """Return the message on the site or body that is furthest from its target at the nearest pose (n_q,)."""
    if isinstance(worst, BodyAngle):
        angle, asked = (np.degrees(x) for x in (angles_of(mechanism, worst.index, pose)[0], worst.angle_rad))
        return (
            f"{where}.{worst.body} = {asked:.6g} deg is out of reach{together}: {worst.body} comes no nearer than"
            f" {angle:.6g} deg, {abs(angle - asked):.4g} deg away"
        )
    place = places_of(mechanism, worst.index, pose)[0]
    return (
        f"{where}.{worst.site} = {shown(worst.point)} m is out of reach{together}: {worst.site} comes no nearer than"
        f" {shown(np.where(np.abs(place) < 1e-6, 0.0, place))} m, {worst.distance_m(place):.4g} m away"
    )


def shown(point: np.ndarray) -> str:
    """Return a point (3,) as problem files write it."""
    if not np.any(np.isnan(point)):
        return "[" + ", ".join(f"{x:.6g}" for x in point) + "]"
    return "{ " + ", ".join(f"{axis} = {x:.6g}" for axis, x in zip(AXES, point, strict=True) if not np.isnan(x)) + " }"


_LEGAL = (
    "it is a box { z = [low, high] }, a wall { normal = [x, y, z], at = [x, y, z] }, a tube { along = [[x, y, z], ...],"
    " radius_m = 0.01 }, or a list of these"
)


def site_limits_of(table: dict[str, dict | list[dict]], mechanism: Mechanism) -> tuple[SiteLimit, ...]:
    """Return the limits of limits.site: { foot = { z = [0.0, inf] } }, or a list of boxes, walls and tubes."""
    found: list[SiteLimit] = []
    for site, value in table.items():
        where = f"limits.site.{site}"
        index = site_index(mechanism.model, site, "limits.site", ProblemError)
        numbered = isinstance(value, list)
        for k, one in enumerate(value if isinstance(value, list) else [value]):
            number = f"[{k}]" if numbered else ""
            for what, low, high, shape in _limits(one, f"{where}{number}"):
                name = f"{site}{number}.{what}"
                found.append(SiteLimit(site=site, index=index, what=what, name=name, low=low, high=high, **shape))
        if numbered and not value:
            raise ProblemError(f"{where} limits nothing; {_LEGAL}, got []")
    return tuple(found)


def body_limits_of(table: dict[str, list[float]], mechanism: Mechanism) -> tuple[BodyLimit, ...]:
    """Return the limits of limits.body_deg: { shank = [low, high] } [deg]."""
    found = []
    for body, value in table.items():
        low, high = np.radians(interval(value, f"limits.body_deg.{body}"))
        index = turning_body(body, "limits.body_deg", mechanism)
        found.append(BodyLimit(body=body, index=index, low=float(low), high=float(high)))
    return tuple(found)


def _limits(one: dict, where: str) -> list[tuple[str, float, float, dict[str, Any]]]:
    """Return the limits of one box, wall or tube: kind, bounds and shape of each."""
    if not one:
        raise ProblemError(f"{where} limits nothing; {_LEGAL}, got {{}}")
    kind = next((kind for kind in SITE_LIMITS if set(one) & set(kind.__struct_fields__)), None)
    if kind is None:
        legal = ", ".join((*AXES, *(key for shape in (Wall, Tube) for key in shape.__struct_fields__)))
        raise ProblemError(f"unknown key '{where}.{next(iter(one))}'; keys are {legal}")
    _refuse_half_a_shape(one, kind, where)
    found = read(kind, one, where)
    if isinstance(found, Wall):
        normal, length = np.array(found.normal), float(np.linalg.norm(found.normal))
        if length < _MIN_LENGTH:
            raise ProblemError(f"{where}.normal must not be zero and must point to the allowed side, got {one['normal']!r}")
        shape = {"normal": normal / length, "origin": float(normal @ np.array(found.at)) / length}
        return [("wall", 0.0, np.inf, shape)]
    if isinstance(found, Tube):
        along = np.array(found.along)
        short = np.flatnonzero(np.linalg.norm(np.diff(along, axis=0), axis=1) < _MIN_LENGTH)
        if len(short):
            again = one["along"][int(short[0])]
            raise ProblemError(f"{where}.along must have distinct consecutive points, got {again!r} twice in a row")
        return [("tube", 0.0, found.radius_m, {"along": along})]
    given = {axis: getattr(found, axis) for axis in AXES if getattr(found, axis) is not None}
    bounds = {axis: interval(ends, f"{where}.{axis}") for axis, ends in given.items()}
    bounded = {axis: ends for axis, ends in bounds.items() if np.any(np.isfinite(ends))}
    return [(axis, *ends, {"normal": np.eye(3)[AXES.index(axis)]}) for axis, ends in bounded.items()]


def _refuse_half_a_shape(one: dict, kind: type[Wall | Tube | Box], where: str) -> None:
    """Refuse a wall without a point or a normal, and a tube without a radius or a path."""
    for key in kind.__struct_fields__ if kind is not Box else ():
        if key not in one:
            raise ProblemError(f"{where} is a {kind.__name__.lower()} and lacks {key}; {_LEGAL}")
