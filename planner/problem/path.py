"""The path that a site follows, and the mechanism guided along it."""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.errors import AssemblyError, ModelError, ProblemError
from linkplan.models.guide.curve import Curve, curve_through
from linkplan.models.guide.guided import GuidedMechanism, guided
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import accelerations, joint_rates
from linkplan.models.poses.assembly import close_at, follow
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.models.tree.dynamics import site_index
from linkplan.planner.problem.keys.motion import PathSection
from linkplan.planner.problem.sites import AXES, BodyLimit, SiteLimit, SitePoint, pose_at, shown

# A motion follows its path if its site's distance from the path is at most this share of the mechanism's extent.
PATH_SHARE = 1e-6
# Number of poses along a path between its ends.
_PATH_SAMPLES = 181


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Feed:
    """The motion along a curve of length L at constant speed, as a reference: at time t the way is L t / `period_s`."""

    curve: Curve
    period_s: float
    periodic: bool = False

    def derivative(self, time_s: np.ndarray, order: int = 0) -> np.ndarray:
        """Return the curve's parameter (order 0), its rate (1) or its acceleration (2), (n, 1), at times (n,) [s]."""
        speed = self.curve.ways[1][-1] / self.period_s
        x = self.curve.at_way(np.clip(speed * np.asarray(time_s, dtype=float), 0.0, self.curve.ways[1][-1]))
        return (x, *self.curve.along(x, speed, np.zeros(len(x))))[order][:, None]

    def inner_times(self, _: float) -> np.ndarray:
        """Return the times (n,) [s] at which the curve's pieces join."""
        knots, until = self.curve.ways
        return np.interp(self.curve.corners, knots, until) / until[-1] * self.period_s

    def stretched(self, factor: float) -> "Feed":
        """Return the motion that takes `factor` times as long."""
        return replace(self, period_s=factor * self.period_s)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class SitePath:
    """A site, its index in the model, and the curve that it follows; `within_m` is its largest distance from it [m].

    `speeds` and `accelerations` are those along the curve at its beginning and end [m/s, m/s2], NaN where they are free.
    `feed` tells whether the speed is constant.
    """

    site: str
    index: int
    curve: Curve
    within_m: float
    speeds: tuple[float, float] = (0.0, 0.0)
    accelerations: tuple[float, float] = (np.nan, np.nan)
    feed: bool = False

    def rates(self, k: int) -> tuple[float, float]:
        """Return the first two time derivatives of the curve's parameter at its beginning (k = 0) or end (1)."""
        x, ends = self.curve.length * np.array([float(k)]), np.array([self.speeds, self.accelerations])
        rate, acceleration = self.curve.along(x, *ends[:, k : k + 1])
        return float(rate[0]), float(acceleration[0])

    def guided(self, mechanism: Mechanism, pose: np.ndarray) -> GuidedMechanism:
        """Return a mechanism guided along the path from a closed pose (n_q,) at its beginning.

        Raises:
            ProblemError: if the site's place does not determine the pose, or no drive moves some coordinate.
        """
        return _guided(self, mechanism, tuple(pose.tolist()))

    def end_poses(
        self, mechanism: Mechanism, ranges: np.ndarray, limits: Sequence[SiteLimit | BodyLimit], begin: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the independent joints' positions, speeds and accelerations (2, n_s) at both ends of the path.

        The first pose is the nearest to `begin`. Speeds and accelerations are NaN where they are free.

        Raises:
            ProblemError: if the site does not reach the whole path.
        """
        (first,) = self.curve.places(np.zeros(1))
        points = (SitePoint(site=self.site, index=self.index, point=first),)
        s, _ = pose_at(points, "the beginning of path", mechanism, ranges, limits, begin)
        pose, free = close_at(mechanism, s), mechanism.independent
        ends = []
        guide, along = self.guided(mechanism, pose), np.linspace(0.0, self.curve.length, _PATH_SAMPLES)
        poses, places = np.append(pose, 0.0)[None], self.curve.places(along)
        for k, x in enumerate(along):
            try:
                poses = follow(guide, np.array([[x]]), poses[0])
            except AssemblyError as error:
                raise ProblemError(self._left_at(places[k], x)) from error
            pose = poses[0, :-1]
            if np.linalg.norm(places_of(mechanism, self.index, pose)[0] - places[k]) > self.within_m:
                raise ProblemError(self._left_at(places[k], x))
            if x in (0.0, along[-1]):
                rate, bend = (np.array([[value]]) for value in self.rates(int(x > 0)))
                v, a = joint_rates(guide, poses, rate)[0, free], accelerations(guide, poses, rate, bend)[0, free]
                # A joint that the path does not move is free like the others.
                ends.append(
                    (pose[free], v if np.isfinite(rate).all() else v * np.nan, a if np.isfinite(bend).all() else a * np.nan)
                )
        s, v, a = (np.stack(of) for of in zip(*ends, strict=True))
        return s, v, a

    def _left_at(self, place: np.ndarray, x: float) -> str:
        return (
            f"path leaves the reach of site {self.site} at {shown(place)}, {x:.4g} m of {self.curve.length:.4g} m from its"
            " beginning"
        )


@functools.lru_cache(maxsize=8)
def _guided(path: SitePath, mechanism: Mechanism, pose: tuple[float, ...]) -> GuidedMechanism:
    try:
        return guided(mechanism, path.index, path.curve, np.array(pose))
    except ModelError as error:
        raise ProblemError(str(error)) from error


def site_path_of(section: PathSection, mechanism: Mechanism, *, smooth: bool) -> SitePath:
    """Return the path of a [path] table; if `smooth`, the third derivative does not jump at a polyline's roundings.

    Raises:
        ProblemError: for points through which there is no such curve.
    """
    if not section.points:
        raise ProblemError("[path] needs path.points, [x, y, z] in metres each, or path.file")
    if section.blend_m is not None and section.shape != "polyline":
        raise ProblemError(f"path.blend_m rounds the corners of shape 'polyline', got shape '{section.shape}'")
    try:
        curve = curve_through(section.points, section.shape, section.blend_m or 0.0, "path", 3 if smooth else 2)
    except ModelError as error:
        raise ProblemError(str(error)) from error
    index = site_index(mechanism.model, section.site, "path.site", ProblemError)
    names, feed = ("start", "goal"), section.feed_m_s
    speeds, bends = ([getattr(section, f"{name}_{key}") for name in names] for key in ("speed_m_s", "acceleration_m_s2"))
    given = [f"path.{name}_speed_m_s" for name, speed in zip(names, speeds, strict=True) if speed is not None]
    given += [f"path.{name}_acceleration_m_s2" for name, bend in zip(names, bends, strict=True) if bend is not None]
    if feed is not None and given:
        raise ProblemError(f"path.feed_m_s is the speed from the first point to the last; it excludes {given[0]}")
    for name, speed, bend in zip(names, speeds, bends, strict=True):
        if bend and speed is None:
            raise ProblemError(f"path.{name}_acceleration_m_s2 is 0 without path.{name}_speed_m_s, got {bend:g}")
    if feed is not None:
        speeds = [np.nan if feed == "free" else feed] * 2
    start, goal = (0.0 if speed is None else speed for speed in speeds)
    first, last = (np.nan if bend is None else bend for bend in bends)
    return SitePath(
        site=section.site,
        index=index,
        curve=curve,
        within_m=PATH_SHARE * mechanism.extent_m,
        speeds=(start, goal),
        accelerations=(first, last),
        feed=feed is not None,
    )


def path_rows(columns: dict[str, np.ndarray], what: str, _mechanism: Mechanism) -> dict[str, list]:
    """Return the points of [path] in the columns of a CSV file.

    Raises:
        ProblemError: if a coordinate is missing.
    """
    heads = [f"{axis}_m" for axis in AXES]
    if sorted(columns) != heads:
        raise ProblemError(f"{what} has columns {', '.join(heads)}, got {', '.join(columns)}")
    return {"points": np.column_stack([columns[head] for head in heads]).tolist()}


def check_path(path: SitePath | None, kind: str, others: Mapping[str, object]) -> None:
    """Refuse a path without a motion of kind "follow", such a motion without a path, and settings that exclude a path.

    Args:
        path: the problem's path.
        kind: of its motion.
        others: settings that exclude a path, by their name in messages; None, False or empty if not given.
    """
    if path is None:
        if kind == "follow":
            raise ProblemError("motion.kind 'follow' needs a [path]: the site, and points or a file")
        return
    if kind != "follow":
        raise ProblemError(f"[path] belongs to motion.kind 'follow', got '{kind}'; limits.site has tubes")
    given = [name for name, value in others.items() if value]
    if given:
        raise ProblemError(f"motion.kind 'follow' cannot be combined with {given[0]}")
