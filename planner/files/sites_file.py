"""Sites in a problem file: where they start, pass and end (start_at, a waypoint's at, goal_at), and stay (limits.site)."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.names import nearest
from linkplan.models.poses.inverse_kinematics import SiteTargets, independent_rows_of, places_of, site_pose
from linkplan.models.tree.sites import site_index
from linkplan.planner.files.values import interval
from linkplan.planner.problem.limits import Limits
from linkplan.planner.problem.sites import AXES, SiteLimit, SitePoint
from linkplan.planner.problem.values import number

WALL, TUBE = ("normal", "at"), ("along", "radius_m")
# Corners of a tube's polyline at the most: each segment is an expression at every node.
_MOST_CORNERS = 200
# A normal, or a segment of a polyline, shorter than this [1 or m] has no direction.
_NO_LENGTH = 1e-9
# A coordinate of a nearest place below this [m] is shown as none: it is found to the root of rounding.
_NOTHING_M = 1e-6


def points_of(section: dict, key: str, mechanism: Mechanism, within: str = "motion") -> tuple[SitePoint, ...]:
    """Return where a start, goal or waypoint asks sites to be: { foot = [x, y, z] }, or { foot = { z = 0.2 } }."""
    where = f"{within}.{key}"
    table = section.get(key, {})
    if not isinstance(table, dict):
        raise ProblemError(f"{where} is a table of site = [x, y, z] in metres, got {table!r}")
    found = []
    names = [joint.name for joint in mechanism.joints]
    for name, value in table.items():
        if name in names and isinstance(value, int | float):
            by_joint = f"{within}.{key.removesuffix('_at')}_deg"
            raise ProblemError(
                f"{where}.{name} is a site's place, [x, y, z] in metres; joint {name}'s position is {by_joint}"
            )
        index = site_index(mechanism.model, name, where, ProblemError)
        found.append(SitePoint(site=name, index=index, point=_point(value, f"{where}.{name}")))
    return tuple(found)


def _point(value: object, where: str) -> np.ndarray:
    if isinstance(value, list):
        return _vector(value, where, "or a table of those coordinates that matter: { x = 0.1, z = 0.2 }")
    if not isinstance(value, dict) or not value:
        raise ProblemError(f"{where} is [x, y, z] in metres, or a table such as {{ x = 0.1, z = 0.2 }}, got {value!r}")
    _check_keys(value, AXES, where)
    return np.array([number(value[axis], f"{where}.{axis}") if axis in value else np.nan for axis in AXES])


def _vector(value: object, where: str, otherwise: str = "") -> np.ndarray:
    if not isinstance(value, list) or len(value) != 3:
        raise ProblemError(f"{where} is [x, y, z] in metres{', ' if otherwise else ''}{otherwise}, got {value!r}")
    return np.array([number(one, f"{where}[{k}]") for k, one in enumerate(value)])


def _check_keys(table: dict, legal: tuple[str, ...], where: str) -> None:
    for key in table:
        if key not in legal:
            raise ProblemError(f"unknown key '{where}.{key}'{nearest(key, legal)}; keys are {', '.join(legal)}")


def pose_at(
    points: tuple[SitePoint, ...], where: str, mechanism: Mechanism, limits: Limits, begin: np.ndarray
) -> tuple[np.ndarray, tuple[int, ...]]:
    """Return independent positions (n_s,) with sites at their points, nearest to a closed pose, and `Motion.goal_rows`.

    Args:
        points: where sites are to be.
        where: the key that asks for it.
        mechanism: whose sites they are.
        limits: of a problem; ranges are kept, limits on sites where there is a pose that does.
        begin: a closed pose (n_q,) to begin from.

    Raises:
        ProblemError: when no such pose is found, with the nearest place and how far away it is.
    """
    targets = SiteTargets(sites=np.array([p.index for p in points]), points=np.array([p.point for p in points]))

    def within(q: np.ndarray) -> bool:
        return all(
            limit.low <= float(limit.value(places_of(mechanism, limit.index, q))[0]) <= limit.high for limit in limits.site
        )

    found = site_pose(mechanism, targets, begin, limits.position, within)
    if not found.arrived(mechanism):
        worst = points[int(np.argmax(found.off_m))]
        place = places_of(mechanism, worst.index, found.pose)[0]
        together = " together with the other sites" if len(points) > 1 else ""
        raise ProblemError(
            f"{where}.{worst.site} = {shown(worst.point)} is out of reach{together}: {worst.site} comes no nearer than"
            f" {shown(np.where(np.abs(place) < _NOTHING_M, 0.0, place))}, {found.off_m.max():.4g} m away"
        )
    rows = independent_rows_of(mechanism, targets, found.pose, limits.position)
    active = mechanism.dof - len([i for i in mechanism.passive_dofs if i in mechanism.independent])
    if not rows:
        raise ProblemError(
            f"{where} asks nothing of the motion: what it names of {', '.join(p.site for p in points)} does not move"
        )
    s = found.pose[mechanism.independent]
    return s, rows if len(rows) < active else ()


def shown(point: np.ndarray) -> str:
    """Return a point (3,) as a problem file has it."""
    if not np.any(np.isnan(point)):
        return "[" + ", ".join(f"{x:.6g}" for x in point) + "]"
    return "{ " + ", ".join(f"{axis} = {x:.6g}" for axis, x in zip(AXES, point, strict=True) if not np.isnan(x)) + " }"


_LEGAL = (
    "it is a box { z = [low, high] }, a wall { normal = [x, y, z], at = [x, y, z] }, a tube { along = [[x, y, z], ...],"
    " radius_m = 0.01 }, or a list of these"
)


def site_limits_of(section: dict, mechanism: Mechanism) -> tuple[SiteLimit, ...]:
    """Return the limits of limits.site: { foot = { z = [0.0, inf] } }, or a list of boxes, walls and tubes."""
    table = section.get("site", {})
    if not isinstance(table, dict):
        raise ProblemError(f"limits.site is a table of site = limits, got {table!r}")
    found: list[SiteLimit] = []
    for site, value in table.items():
        of = _Site(name=site, index=site_index(mechanism.model, site, "limits.site", ProblemError))
        if not isinstance(value, list):
            found += _limits(value, f"limits.site.{site}", of)
            continue
        if not value:
            raise ProblemError(f"limits.site.{site} limits nothing; {_LEGAL}, got []")
        for k, one in enumerate(value):
            found += _limits(one, f"limits.site.{site}[{k}]", _Site(name=site, index=of.index, number=f"[{k}]"))
    return tuple(found)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Site:
    """A site whose limits are read, and what tells those apart where there are several."""

    name: str
    index: int
    number: str = ""

    def limited(self, what: str, low: float, high: float, **shape: Any) -> SiteLimit:
        """Return its limit of a kind."""
        name = f"{self.name}{self.number}.{what}"
        return SiteLimit(site=self.name, index=self.index, what=what, name=name, low=low, high=high, **shape)


def _limits(one: object, where: str, of: _Site) -> list[SiteLimit]:
    """Return the limits of one box, wall or tube."""
    if not isinstance(one, dict) or not one:
        raise ProblemError(f"{where} limits nothing; {_LEGAL}, got {one!r}")
    if set(one) & set(WALL):
        return [_wall(one, where, of)]
    if set(one) & set(TUBE):
        return [_tube(one, where, of)]
    _check_keys(one, (*AXES, *WALL, *TUBE), where)
    bounds = {axis: interval(one[axis], f"{where}.{axis}") for axis in AXES if axis in one}
    bounded = {axis: ends for axis, ends in bounds.items() if np.any(np.isfinite(ends))}
    return [of.limited(axis, *ends, normal=np.eye(3)[AXES.index(axis)]) for axis, ends in bounded.items()]


def _wall(one: dict, where: str, of: _Site) -> SiteLimit:
    _check_keys(one, WALL, where)
    for key in WALL:
        if key not in one:
            raise ProblemError(f"{where} is a wall and lacks {key}: {{ normal = [x, y, z], at = [x, y, z] }}")
    normal, at = (_vector(one[key], f"{where}.{key}") for key in WALL)
    length = float(np.linalg.norm(normal))
    if length < _NO_LENGTH:
        raise ProblemError(f"{where}.normal points to the free side and is not zero, got {one['normal']!r}")
    return of.limited("wall", 0.0, np.inf, normal=normal / length, origin=float(normal @ at) / length)


def _tube(one: dict, where: str, of: _Site) -> SiteLimit:
    _check_keys(one, TUBE, where)
    for key in TUBE:
        if key not in one:
            raise ProblemError(f"{where} is a tube and lacks {key}: {{ along = [[x, y, z], [x, y, z]], radius_m = 0.01 }}")
    given = one["along"]
    if not isinstance(given, list) or not 2 <= len(given) <= _MOST_CORNERS:
        raise ProblemError(f"{where}.along is a list of 2 to {_MOST_CORNERS} points [x, y, z] in metres, got {given!r}")
    along = np.array([_vector(point, f"{where}.along[{k}]") for k, point in enumerate(given)])
    short = np.flatnonzero(np.linalg.norm(np.diff(along, axis=0), axis=1) < _NO_LENGTH)
    if len(short):
        raise ProblemError(f"{where}.along goes on from point to point, got {given[int(short[0])]!r} twice in a row")
    return of.limited("tube", 0.0, number(one["radius_m"], f"{where}.radius_m", positive=True), along=along)
