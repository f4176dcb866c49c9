"""A limit at every instant of a motion, with its parts for the program, the certificate, the proof and the diagnosis.

A limit at nodes is a row of each node. A limit at every instant is a row of each interval, on Bernstein coefficients. A
limit object holds the structure of a program, and objects of equal structure are equal; numbers come from the problem.

A new kind is a final class in a file of this folder that has the members of `Limit`; `kinds.py` finds it there.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np
from msgspec import Struct, structs

from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.planner.files.structs import Beside, InJson
from linkplan.planner.limits.bounds import Affine, EffortBounds
from linkplan.planner.limits.samples import Samples, least_between
from linkplan.planner.problem.extra import as_no_number
from linkplan.planner.problem.instant import Instant, Scales
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.sites import Task
from linkplan.planner.trajectory import Trajectory

Bounds = tuple[float, float]
# Independent joints with rows: none, all, or some by their index.
WhichJoints = bool | Collection[int]
# Limits that cannot be removed from a problem are widened by this factor.
RELAXED_FACTOR = 1e3


class Tightened(Enum):
    """The unit in which a row is tightened after an overrun between the nodes."""

    BY_SHARE = "of the bound"
    SQUARED = "the bound's unit; the row is its square"
    IN_UNITS = "the row's unit, because a place or a length has no natural size"
    IN_PROBLEM = "the problem's unit; the joint's limit moves inwards"
    LATER_IN_PROBLEM = "the bound's unit, and after the first time also the problem's"


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitFacts:
    """The properties of a kind of limit that search, refinement, diagnosis and messages use.

    Args:
        kind: of its margin and of its tightening.
        words: a title with {} for a name.
        bound: words on its bounds with {} for a name; by default the limit on its title.
        verb: of a sentence on its value at a pose.
        beyond: the word for an overrun.
        tightened: how its row is tightened after an overrun between the nodes; None if its rows hold at every instant.
        enclosable: whether rows of intervals can impose it at every instant.
        enclosed_with_several: whether they do from the start with several degrees of freedom.
        jumps_with_effort: whether its row jumps with the effort.
        of_position: whether its row is a function of the pose only.
        at_given_poses: whether its row binds at nodes whose pose is given, too.
        second_order: whether efforts act only on the second derivative of its row, as far as known; by default if it is
            `of_position`.
        in_phase_plane: whether the phase plane's motions satisfy it.
        followed_with: the largest number of actuators with which legs of the phase plane follow it; 0 if they never do.
        narrows_efforts: whether it restricts the efforts at a pose, which the phase plane ignores.
        of_planned_effort: whether its row is a planned effort, whose optimum is often at its limit.
        by_size: whether a factor moves its bounds by a share of its size instead of multiplying them.
    """

    kind: str
    words: str = "{}"
    bound: str | None = None
    verb: str = "is"
    beyond: str = "beyond"
    tightened: Tightened | None = Tightened.BY_SHARE
    enclosable: bool = False
    enclosed_with_several: bool = False
    jumps_with_effort: bool = False
    of_position: bool = False
    at_given_poses: bool = False
    second_order: bool | None = None
    in_phase_plane: bool = False
    followed_with: float = 0
    narrows_efforts: bool = False
    of_planned_effort: bool = False
    by_size: bool = False


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Rows:
    """A limit's rows in a program, scaled; without any, the bounds of the unknowns impose it.

    Args:
        node: the row at a node, of an instant and of the limit's own parameters; None without one.
        numbers: the values of these parameters, of which there are `n_numbers`.
        interval: the limit's field of `IntervalRows` and its entry there, of the places of its unknowns.
        interval_numbers: the values of the parameters of that row.
        unknowns: the kind of equation of its `n_unknowns` algebraic unknowns, and the expressions that they equal.
        jerk: the independent coordinates on whose jerk the row depends; their accelerations have no jumps.
    """

    node: Callable[[Instant, ca.SX], ca.SX] | None = None
    n_numbers: int = 0
    numbers: Callable[[Problem], Sequence[float]] = lambda _: ()
    interval: Callable[[tuple[int, ...]], tuple[str, Any]] | None = None
    interval_numbers: Callable[[Problem, Scales], Sequence[float]] = lambda *_: ()
    n_unknowns: int = 0
    unknowns: Callable[[Instant, ca.SX], tuple[str, list[ca.SX]]] | None = None
    jerk: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False, slots=True)
class Measured:
    """A limited quantity at poses or along a motion: its `values` (n,), their bounds [low, high], and their unit.

    `name` is that of the limit's actuator, joint, closure, tendon or site. Overruns are shares of `size`, by default of the
    limit itself. Overruns up to `slack` are due to rounding: one number, or one for each of [low, high]; by default
    `rounding_of` the limit. Intervals with a `bent` sample (n,) have a kink. `coefficients` (n_nodes, n_intervals) are the
    Bernstein coefficients of values that are polynomials. `at_times` gives the values at other instants (m,) [s], for
    samples near the limit, where parabolas are too coarse. Closed poses are exact to a share of `pose_size`, by default the
    size. `known_from` returns True if the tasks of an open pose determine the values.
    """

    name: str
    values: np.ndarray
    bounds: Sequence[float] | np.ndarray
    unit: str = ""
    size: float | None = None
    slack: float | tuple[float, float] | None = None
    bent: np.ndarray | None = None
    coefficients: np.ndarray | None = None
    at_times: Callable[[np.ndarray], np.ndarray] | None = None
    pose_size: float | None = None
    known_from: Callable[[Sequence[Task]], bool] = lambda _: False


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Claimed:
    """A claim on a limit, for a proof: low - slack[0] <= value <= high + slack[1] at every instant, in SI.

    Args:
        name: of the claim.
        unit: of its display, `per_unit` times SI.
        bounds: [low, high].
        value: a function of a `proof.motion.Kinetics` (of a `State` if `of_planned`) with balls as values; or a CasADi
            function of the pose q or of the first of `motion_symbols`; or one function of q and of the parameter of the
            followed path for each interval of the trajectory.
        of_planned: whether the value needs planned positions and efforts only, and no speeds, or is of one kinetics.
        slack: the allowances of both bounds; those for rounding by default.
        unknown: why the value cannot be enclosed.
    """

    name: str
    unit: str
    bounds: Sequence[float] | np.ndarray
    value: Callable[[Any], Any] | ca.Function | Sequence[ca.Function]
    of_planned: bool = False
    slack: tuple[float, float] | None = None
    per_unit: float = 1.0
    unknown: str = ""


class Margin(Struct, frozen=True, eq=False, kw_only=True):
    """The worst instant of a limit: `value` against `limit` in `unit`; `left` is negative if the limit is overrun.

    `of` is the limit, a `Limit` or that of another system, of which `facts` and `item` are read. `name` is the name of its
    actuator, closure, tendon or site.
    """

    of: Beside[Any]
    name: str
    value: float
    limit: float
    left: float
    unit: str
    time_s: float
    overrun: Beside[np.ndarray]  # (n_intervals,) overrun in each interval as a share of the limit, 0 if it is satisfied
    upper: Beside[bool]  # whether the limit is an upper one
    size: Beside[float]  # of which overruns are shares
    slack: Beside[float] = 0.0  # the overrun that is due to rounding

    @InJson
    def what(self) -> str:
        """The kind of limit."""
        return self.of.facts.kind

    @property
    def item(self) -> int:
        """The number of the limit within its kind."""
        return self.of.item

    @property
    def kept(self) -> bool:
        """Whether the limit is satisfied, except for rounding."""
        return self.left >= -self.slack

    @property
    def left_shown(self) -> float:
        """What is left, without the overrun of a satisfied limit, which is due to rounding."""
        return max(self.left, 0.0) if self.kept else self.left

    @property
    def share(self) -> float:
        """The remaining margin as a share of the limit's size."""
        return self.left_shown / self.size

    @property
    def title(self) -> str:
        """The limited quantity as text."""
        return self.of.facts.words.format(self.name)

    @property
    def bound(self) -> str:
        """Its limit as text."""
        words = self.of.facts.bound
        return f"the limit on {self.title}" if words is None else words.format(self.name)

    def sentence(self, verb: str = "comes to") -> str:
        """Return a sentence with the worst value, its time and its limit."""
        at, limit = f"at t = {self.time_s:.4g} s", f"{self.limit:.4g} {self.unit}".rstrip()
        if not np.isfinite(self.value):  # such as a jerk where an acceleration jumps
            found = f"is {as_no_number(self.value)}" if verb == "comes to" else "would be infinite"
            return f"{self.title} {found} {at}; its limit is {limit}"
        amount = f"{self.value:.4g} {self.unit}".rstrip()
        off = f"{abs(self.left):.3g} {self.unit}".rstrip()
        return f"{self.title} {verb} {amount} {at}, {off} {self.of.facts.beyond} its limit of {limit}"


class Limit(ABC):
    """One limit of one problem; `key` is its key in a problem file, `item` its number within its kind."""

    __slots__ = ()
    key: ClassVar[str]
    item: int

    @classmethod
    @abstractmethod
    def of(cls, problem: Problem, **options: WhichJoints) -> list[Self]:
        """Return the limits of this kind that a problem has.

        Options: `enclosed` imposes enclosable limits at every instant, `position_rows` the ranges of independent joints, of
        all or of some by their index.
        """

    @property
    @abstractmethod
    def facts(self) -> LimitFacts:
        """Its properties."""

    @property
    def rows(self) -> Rows:
        """Its rows in a program."""
        return Rows()

    @abstractmethod
    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        """Return the scaled bounds of its row, or of its coefficients on an interval."""

    @abstractmethod
    def measured(self, at: Any) -> Measured:
        """Return the limited quantity at `Samples` of a motion; `Poses` suffice if it is `of_position`."""

    @abstractmethod
    def claims(self, problem: Problem, trajectory: Trajectory) -> Iterator[Claimed]:
        """Yield the claims of a proof, at least one."""

    def affine(self, problem: Problem) -> Affine | None:
        """Return the quantity that bounds the motion of one degree of freedom at a pose and speed; None by default."""
        return None

    @classmethod
    def effort_bounds(cls, problem: Problem) -> EffortBounds | None:
        """Return the efforts that the limits of this kind permit; None if there are none or if they bound no effort."""
        return None

    @classmethod
    def relaxed(cls, problem: Problem, factor: float) -> Problem:
        """Return a problem with its limits of this kind relaxed by a common factor; infinity removes them."""
        return with_limits(problem, **{cls.key: _scaled(getattr(problem.limits, cls.key), factor)})


def with_limits(problem: Problem, **changes: Any) -> Problem:
    """Return a problem with the given `changes` to its limits."""
    return problem.varied(limits=replace(problem.limits, **changes))


def _scaled(values: np.ndarray | Mapping[str, float], factor: float) -> np.ndarray | dict[str, float]:
    """Return rows [low, high] (n, 2), or largest values by name, times a factor; an infinite one removes zeros too."""
    if isinstance(values, Mapping):
        return {name: most * factor for name, most in values.items()} if np.isfinite(factor) else {}
    return values * factor if np.isfinite(factor) else np.broadcast_to([-np.inf, np.inf], np.shape(values)).copy()


def rounding_of(bound: float) -> float:
    """Return the overrun of a bound that is due to rounding, in the certificate as in a proof."""
    return ROUNDING_SHARE * max(1.0, abs(bound)) if np.isfinite(bound) else 0.0


def squared_claim(what: str, unit: str, most: float, value: Callable[[Any], Any] | ca.Function) -> Claimed:
    """Return the claim that a size, given by its square `value`, is at most `most`, except for rounding."""
    slack = 2 * ROUNDING_SHARE * max(1.0, most) * most
    return Claimed(name=f"squared {what}", unit=unit, bounds=(-np.inf, most**2), value=value, slack=(0.0, slack))


def limited_rows(bounds: np.ndarray) -> list[int]:
    """Return the indices of [low, high] rows with a finite bound."""
    return [int(j) for j in np.flatnonzero(np.isfinite(bounds).any(axis=1))]


def limited_joints(problem: Problem, bounds: np.ndarray) -> list[tuple[int, int | None]]:
    """Return the joints with a finite bound (n_q, 2), independent ones with their column first, then dependent ones."""
    limited, independent = limited_rows(bounds), problem.mechanism.independent.tolist()
    own = [(joint, column) for column, joint in enumerate(independent) if joint in limited]
    return [*own, *((joint, None) for joint in limited if joint not in independent)]


def limit_margin(limit: Limit, samples: Samples) -> Margin:
    """Return the margin of a limit along a motion."""
    return margin_of(limit, limit.measured(samples), samples.points, samples.time)


@np.errstate(invalid="ignore")  # NaN (infinity minus infinity) does not count as satisfied
def margin_of(of: Limit, measured: Measured, points: np.ndarray, time: np.ndarray) -> Margin:
    """Return the margin of a quantity along a motion, measured at times (n,) [s], which are `points` of every interval.

    The least margin of an interval with a kink is that of the samples, without interpolation by parabolas. Bernstein
    coefficients bound the margin from below.
    """
    (low, high), values, bent = measured.bounds, measured.values, measured.bent
    inside = np.minimum(values - low, high - values)
    at = int(np.argmin(inside))
    if np.isfinite(inside[at]):  # where a limit binds for a while, the first instant
        at = int(np.argmax(inside <= inside[at] + rounding_of(values[at])))
    limit = high if high - values[at] <= values[at] - low else low
    least = least_between(inside, points)
    if bent is not None:
        rows, kinked = inside.reshape(-1, len(points)), bent.reshape(-1, len(points)).any(axis=1)
        least = np.where(kinked, rows.min(axis=1), least)
    if measured.coefficients is not None:
        hull = np.minimum(measured.coefficients - low, high - measured.coefficients).min(axis=0)
        least = np.maximum(least, hull)
    left = float(least.min())
    value = values[at] if not np.isfinite(left) else limit - left if limit == high else limit + left
    size = float(measured.size or abs(limit) or 1.0)
    slack = measured.slack[int(limit == high)] if isinstance(measured.slack, tuple) else measured.slack
    margin = Margin(
        of=of,
        name=measured.name,
        value=float(value),
        limit=float(limit),
        left=left,
        unit=measured.unit,
        time_s=float(time[at]),
        overrun=np.maximum(0.0, -least) / size,
        upper=bool(limit == high),
        size=size,
        slack=rounding_of(float(limit)) if slack is None else slack,
    )
    return margin if measured.at_times is None else _sampled_finely(margin, measured, time.reshape(-1, len(points)))


def clipped(margin: Margin, bounds: Sequence[float] | np.ndarray) -> Margin:
    """Return the margin of an overrun limit, with its value clipped to wider bounds [low, high]."""
    low, high = bounds
    value = float(np.clip(margin.value, low, high))
    left = -abs(value - margin.limit)
    return structs.replace(margin, value=value, left=left, overrun=np.minimum(margin.overrun, -left / margin.size))


def _sampled_finely(margin: Margin, measured: Measured, at: np.ndarray) -> Margin:
    """Return a margin measured at (n_intervals, n_points) [s] again on finer samples in every interval near the limit."""
    (low, high), size, n_points = measured.bounds, margin.size, at.shape[1]
    inside = np.minimum(measured.values - low, high - measured.values).reshape(-1, n_points)
    worst = inside.argmin(axis=1)
    near_share = 1e-3  # of the limit's size
    chosen = np.flatnonzero(inside.min(axis=1) < max(near_share * size, float(inside.min()) + near_share * size))
    rows = np.arange(len(inside))[chosen]
    first, last = at[rows, np.maximum(worst[rows] - 1, 0)], at[rows, np.minimum(worst[rows] + 1, n_points - 1)]
    shares = np.linspace(0.0, 1.0, 33)
    near = first[:, None] + (last - first)[:, None] * shares
    assert measured.at_times is not None  # the caller ensures it
    fine = measured.at_times(near.ravel()).reshape(near.shape)
    left = np.minimum(fine - low, high - fine)
    # Only the finest samples and parabolas through them count; coarse parabolas may overestimate.
    least = np.minimum(least_between(left, shares), inside[rows].min(axis=1))
    overrun = np.zeros(len(inside))
    overrun[rows] = np.maximum(0.0, -least) / size
    row, k = np.unravel_index(int(np.argmin(left)), left.shape)
    upper = bool(high - fine[row, k] <= fine[row, k] - low)
    bound, gap = (high if upper else low), float(least.min())
    value, instant = bound - gap if upper else bound + gap, float(near[row, k])
    return structs.replace(margin, value=value, limit=float(bound), left=gap, time_s=instant, overrun=overrun, upper=upper)
