"""The kinds of limits, and the limits of a problem: those on sites and users' own stand here.

A new kind is one entry in each of the two tables.

A slab's row is n . (p - p_home) / L with the mechanism's extent L. A tube's row is d^2 / r^2 with the distance d from the
polyline. The least distance over the segments has kinks, so the row uses a mean with the weights exp(-k d_i^2 / r^2), which
is smooth and never below the least: a motion that satisfies the row stays in the tube.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.planner.limits.actuators import ControlLimit, EffortRateLimit, MotorLimit, PowerLimit, RobustLimit
from linkplan.planner.limits.joints import (
    BallLimit,
    ClosureForceLimit,
    RangeLimit,
    SingularMarginLimit,
    SpeedLimit,
    TendonLimit,
)
from linkplan.planner.limits.path_limit import (
    BETWEEN_NODES_FACTOR,
    Bounds,
    Instant,
    Margin,
    Measured,
    PathLimit,
    Poses,
    Problem,
    Samples,
    Scales,
    Tightened,
    margin_of,
    with_limits,
)
from linkplan.planner.limits.samples import least_between
from linkplan.planner.problem.extra import Expression, ExtraLimit, expressed, extra_along, uses
from linkplan.planner.problem.sites import SiteLimit

# Between two segments at nearly equal distances, the weighted mean exceeds the least squared distance by at most 0.28 / k of
# r^2. This k reduces a tube's radius there by 0.14 %, and the curvature of its wall stays of the order of 1 / r.
_TUBE_SHARPNESS = 100.0


@dataclass(frozen=True, slots=True)
class SitePathLimit(PathLimit):
    """One limit on a site, number `item` of limits.site; `shape` is its `SiteLimit.key`, which determines its row."""

    key: ClassVar[str] = "site"
    of_position: ClassVar[bool] = True
    item: int
    shape: tuple

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        return [cls(item, limit.key) for item, limit in enumerate(problem.limits.site)]

    @classmethod
    def coordinate(cls, site: int, axis: int) -> Self:
        return cls(-1, (site, tuple(np.eye(3)[axis].tolist())))

    @property
    def is_tube(self) -> bool:
        return len(self.shape) == 3

    @property
    def kind(self) -> str:
        return "tube" if self.is_tube else "site"

    @property
    def tightened(self) -> Tightened:
        return Tightened.SQUARED if self.is_tube else Tightened.IN_UNITS

    def row(self, at: Instant, numbers: ca.SX) -> ca.SX:
        p = at.of_pose("site_places")[:, self.shape[0]]
        if self.is_tube:
            return _tube(p, np.array(self.shape[1]), self.shape[2])
        normal = np.array(self.shape[1])
        return (ca.dot(ca.DM(normal), p) - float(normal @ site_at_home(at.mechanism, self.shape[0]))) / at.mechanism.extent_m

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        limit, mechanism = problem.limits.site[self.item], problem.mechanism
        if self.is_tube:
            return -np.inf, (limit.high / limit.scale) ** 2
        off = limit.origin - float(limit.normal @ site_at_home(mechanism, limit.index))
        return (limit.low + off) / mechanism.extent_m, (limit.high + off) / mechanism.extent_m

    def measured(self, at: Poses) -> Measured:
        mechanism, limit = at.problem.mechanism, at.problem.limits.site[self.item]
        values = limit.value(places_of(mechanism, limit.index, at.q))
        # A tube's distance has no lower bound. A slab's overruns are shares of the mechanism's extent.
        bounds, size = ((-np.inf, limit.high), limit.high) if self.is_tube else ((limit.low, limit.high), mechanism.extent_m)
        return Measured(site_title(limit), values, bounds, "m", size)

    def margin(self, samples: Samples) -> Margin:
        measured = self.measured(samples)
        return _margin_sampled_finely(
            samples, samples.problem.limits.site[self.item], margin_of(self, measured, samples), measured
        )

    @classmethod
    def scaled(cls, problem: Problem, factor: float) -> Problem:
        room_m = (factor - 1) * problem.mechanism.extent_m
        site = problem.limits.site
        wider = tuple(replace(one, low=one.low if one.is_tube else one.low - room_m, high=one.high + room_m) for one in site)
        return with_limits(problem, site=wider)

    @classmethod
    def without(cls, problem: Problem) -> Problem:
        return with_limits(problem, site=())

    @classmethod
    def factor_of(cls, problem: Problem, over: list[Margin]) -> float | None:
        return 1 + BETWEEN_NODES_FACTOR * max(-m.left for m in over) / problem.mechanism.extent_m


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
    """Return the squared distance of p (3,) from a polyline (n, 3), in squared radii, smooth and never underestimated."""
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


def _margin_sampled_finely(samples: Samples, limit: SiteLimit, margin: Margin, measured: Measured) -> Margin:
    """Return a margin measured again on finer samples in every interval near the limit; `measured` are the coarse ones.

    Between two segments a tube's distance has a kink, which parabolas do not fit.
    """
    problem, trajectory, n_points = samples.problem, samples.trajectory, len(samples.points)
    (low, high), size = measured.bounds, measured.size
    inside = np.minimum(measured.values - low, high - measured.values).reshape(-1, n_points)
    worst = inside.argmin(axis=1)
    near_share = 1e-3  # of the limit's size
    chosen = np.flatnonzero(inside.min(axis=1) < max(near_share * size, float(inside.min()) + near_share * size))
    rows, times = np.arange(len(inside))[chosen], samples.time.reshape(-1, n_points)
    first, last = times[rows, np.maximum(worst[rows] - 1, 0)], times[rows, np.minimum(worst[rows] + 1, n_points - 1)]
    shares = np.linspace(0.0, 1.0, 33)
    near = first[:, None] + (last - first)[:, None] * shares
    s, until = trajectory.position_at(near.ravel()), problem.solver.judging_deadline
    q = follow(problem.mechanism, s, trajectory.start_pose, until)
    fine = limit.value(places_of(problem.mechanism, limit.index, q)).reshape(near.shape)
    left = np.minimum(fine - low, high - fine)
    # Only the finest samples and parabolas through them count; coarse parabolas may overestimate.
    least = np.minimum(least_between(left, shares), inside[rows].min(axis=1))
    overrun = np.zeros(len(inside))
    overrun[rows] = np.maximum(0.0, -least) / size
    row, k = np.unravel_index(int(np.argmin(left)), left.shape)
    upper = bool(high - fine[row, k] <= fine[row, k] - low)
    bound, gap = (high if upper else low), float(least.min())
    value, instant = bound - gap if upper else bound + gap, float(near[row, k])
    return replace(margin, value=value, limit=float(bound), left=gap, time_s=instant, overrun=overrun, upper=upper)


@dataclass(frozen=True, slots=True)
class ExtraPathLimit(PathLimit):
    """One of a problem's extra limits."""

    key: ClassVar[str] = "extra"
    words: ClassVar[str] = "the extra limit '{}'"
    row_kind: ClassVar[str] = "path"  # the effect of effort on it is unknown
    tightened: ClassVar[Tightened] = Tightened.IN_UNITS
    n_numbers: ClassVar[int] = 1
    item: int
    expression: Expression
    jumps_with_effort: bool = field()
    of_position: bool = field()
    extra: ExtraLimit = field(compare=False)

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        depends = [uses(one, problem.mechanism) for one in problem.extra_limits]
        return [
            cls(item, one.expression, of["u"], not of["v"] and not of["u"], one)
            for item, (one, of) in enumerate(zip(problem.extra_limits, depends, strict=True))
        ]

    def numbers(self, problem: Problem) -> Sequence[float]:
        return (problem.extra_limits[self.item].size,)

    def row(self, at: Instant, numbers: ca.SX) -> ca.SX:
        return expressed(self.extra, at) / numbers

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        limit = problem.extra_limits[self.item]
        return limit.lower / limit.size, limit.upper / limit.size

    def measured(self, at: Poses) -> Measured:
        limit = at.problem.extra_limits[self.item]
        motion = (at.q, at.v, at.a, at.u) if isinstance(at, Samples) else (at.q,)
        values = extra_along(self.extra, at.problem.mechanism, *motion)
        return Measured(limit.name, values, (limit.lower, limit.upper), limit.unit, limit.size)

    @classmethod
    def scaled(cls, problem: Problem, factor: float) -> Problem:
        wider = tuple(
            replace(one, lower=one.lower - (factor - 1) * one.size, upper=one.upper + (factor - 1) * one.size)
            for one in problem.extra_limits
        )
        return replace(problem, extra_limits=wider)

    @classmethod
    def without(cls, problem: Problem) -> Problem:
        return replace(problem, extra_limits=())

    @classmethod
    def factor_of(cls, problem: Problem, over: list[Margin]) -> float | None:
        return 1 + BETWEEN_NODES_FACTOR * max(-m.left / problem.extra_limits[m.item].size for m in over)


# In the order of their rows in a program.
KINDS: tuple[type[PathLimit], ...] = (
    RangeLimit,
    EffortRateLimit,
    SpeedLimit,
    MotorLimit,
    PowerLimit,
    ClosureForceLimit,
    SingularMarginLimit,
    ControlLimit,
    TendonLimit,
    BallLimit,
    RobustLimit,
    SitePathLimit,
    ExtraPathLimit,
)
# In the order in which a diagnosis removes them to find the one that forbids a motion. Effort limits and joint ranges follow
# after these.
RELAXED: tuple[type[PathLimit], ...] = (
    RobustLimit,
    SpeedLimit,
    PowerLimit,
    ClosureForceLimit,
    MotorLimit,
    ControlLimit,
    EffortRateLimit,
    SingularMarginLimit,
    TendonLimit,
    BallLimit,
    SitePathLimit,
    ExtraPathLimit,
)


def limits_of(problem: Problem, *, enclosed: bool = False, position_rows: bool = False) -> tuple[PathLimit, ...]:
    """Return a problem's limits; the arguments are those of `PathLimit.of`."""
    return tuple(limit for kind in KINDS for limit in kind.of(problem, enclosed=enclosed, position_rows=position_rows))


def relaxed_kinds(problem: Problem) -> list[type[PathLimit]]:
    """Return the kinds of limits of a problem that a diagnosis may remove, in its order."""
    return [kind for kind in RELAXED if kind.of(problem)]


def margins(samples: Samples) -> tuple[Margin, ...]:
    """Return the margins of all limits along a motion, except those on efforts and joints, which are listed by joint."""
    others = (limit for limit in limits_of(samples.problem) if not isinstance(limit, RangeLimit | SpeedLimit))
    found = [limit.margin(samples) for limit in others]
    return tuple(margin for margin in found if margin is not None)
