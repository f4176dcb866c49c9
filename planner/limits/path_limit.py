"""The interface of a limit at every instant of a motion, used by the program, the certificate and the diagnosis.

A limit at nodes is a row of each node. A limit at every instant is a row of each interval, on Bernstein coefficients. A
limit object holds the structure of a program, and objects of equal structure are equal; numbers come from the problem.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, ClassVar, Protocol, Self

import casadi as ca
import numpy as np

from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.errors import AssemblyError
from linkplan.planner.limits.samples import Poses, Samples, least_between, samples_of
from linkplan.planner.problem.extra import as_no_number
from linkplan.planner.problem.instant import Instant, Scales
from linkplan.planner.problem.limits import free_bounds
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory

__all__ = [
    "Bounds",
    "Instant",
    "Margin",
    "Measured",
    "PathLimit",
    "Poses",
    "Problem",
    "Samples",
    "Scales",
    "Tightened",
    "Trajectory",
]

Bounds = tuple[float, float]
MotionArrays = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # q (n, n_q), v and a (n, n_s), u (n, n_u)
# Between nodes a motion slightly exceeds its values at the nodes. A limit that must admit it is widened by this factor.
BETWEEN_NODES_FACTOR = 1.001
# Limits that cannot be removed from a problem are widened by this factor.
RELAXED_FACTOR = 1e3


class Tightened(Enum):
    """The unit in which a row is tightened after an overrun between the nodes."""

    BY_SHARE = "of the bound"
    SQUARED = "of the bound, whose square the row is"
    IN_UNITS = "of the row's unit: a place or a length has no natural size"


@dataclass(frozen=True, eq=False, slots=True)
class Measured:
    """A limited quantity at poses or along a motion: its `values` (n,), their bounds [low, high], and their unit.

    `name` is that of the limit's actuator, joint, closure, tendon or site. Overruns are shares of `size`, by default of the
    limit itself. Intervals with a `bent` sample (n,) have a kink.
    """

    name: str
    values: np.ndarray
    bounds: Sequence[float]
    unit: str = ""
    size: float | None = None
    bent: np.ndarray | None = None


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Margin:
    """The worst instant of a limit: `value` against `limit` in `unit`; `left` is negative if the limit is overrun.

    `of` is the limit, `name` the name of its actuator, closure, tendon or site.
    """

    of: PathLimit
    name: str
    value: float
    limit: float
    left: float
    unit: str
    time_s: float
    overrun: np.ndarray  # (n_intervals,) overrun in each interval as a share of the limit, 0 if it is kept
    upper: bool  # whether the limit is an upper one

    @property
    def what(self) -> str:
        """The kind of limit."""
        return self.of.kind

    @property
    def item(self) -> int:
        """The number of the limit within its kind."""
        return self.of.item

    @property
    def kept(self) -> bool:
        """Whether the limit is kept, except for rounding."""
        return self.left >= -ROUNDING_SHARE * max(1.0, abs(self.limit))

    @property
    def title(self) -> str:
        """The limited quantity in words."""
        return self.of.words.format(self.name)

    def sentence(self, verb: str = "comes to") -> str:
        """Return a sentence with the worst value, its time and its limit."""
        if not np.isfinite(self.value):
            return f"{self.title} is {as_no_number(self.value)} at t = {self.time_s:.4g} s"
        amount = f"{self.value:.4g} {self.unit}".rstrip()
        off = f"{abs(self.left):.3g} {self.unit}".rstrip()
        at = f"at t = {self.time_s:.4g} s"
        return f"{self.title} {verb} {amount} {at}, {off} {self.of.beyond} its limit of {self.limit:.4g}"


class PathLimit(Protocol):
    """One limit of one problem; a kind of limit is a final class that overrides parts of this.

    Args:
        key: the limit's key in a problem file.
        words: a title with {} for a name.
        verb: the verb of a sentence on its value at a pose.
        beyond: the word for an overrun.
        enclosable: rows of intervals can impose it at every instant.
        jumps_with_effort: its row jumps when the effort does.
        of_position: its row is a function of the pose only.
        item: its number within its kind.
    """

    key: ClassVar[str]
    words: ClassVar[str] = "{}"
    verb: ClassVar[str] = "is"
    beyond: ClassVar[str] = "beyond"
    enclosable: ClassVar[bool] = False
    jumps_with_effort: ClassVar[bool] = False
    of_position: ClassVar[bool] = False
    item: int

    @property
    def kind(self) -> str:
        """The kind of its margin and of its tightening."""
        return self.key

    @property
    def row_kind(self) -> str:
        """The kind of its row at a node."""
        return self.kind

    @property
    def tightened(self) -> Tightened | None:
        """How its row is tightened if it is overrun between the nodes; None if the problem is `narrowed` instead."""
        return Tightened.BY_SHARE

    @classmethod
    def of(cls, problem: Problem, **_: bool) -> list[Self]:
        """Return the limits of this kind that a problem has.

        Options: `enclosed` imposes `enclosable` limits at every instant, `position_rows` the ranges of independent joints.
        """
        ...

    # Rows of the program, scaled.

    @property
    def at_nodes(self) -> bool:
        """Whether it is a row at every node."""
        return True

    @property
    def n_numbers(self) -> int:
        """The number of parameters in its row and unknowns."""
        return 0

    def numbers(self, problem: Problem) -> Sequence[float]:
        """Return these parameters."""
        return ()

    def row(self, at: Instant, numbers: ca.SX) -> ca.SX:
        """Return the scaled row at a node."""
        ...

    def bounds(self, problem: Problem, scales: Scales) -> Bounds:
        """Return the bounds of its row, or of its coefficients on an interval."""
        ...

    def interval_row(self, unknowns: tuple[int, ...]) -> tuple[str, Any] | None:
        """Return its field of `IntervalRows` and its entry there; None if it is a row at nodes."""
        return None

    def interval_numbers(self, problem: Problem, scales: Scales) -> Sequence[float]:
        """Return the parameters of its row on an interval."""
        return ()

    @property
    def n_unknowns(self) -> int:
        """The number of algebraic unknowns of its row on an interval."""
        return 0

    def unknowns(self, at: Instant, numbers: ca.SX) -> tuple[str, list[ca.SX]]:
        """Return the kind of equation of these unknowns, and the expressions that they equal."""
        return "", []

    def start_of_unknowns(self, problem: Problem, scales: Scales, motion: MotionArrays) -> np.ndarray:
        """Return these unknowns along a motion (n, n_unknowns)."""
        return np.zeros((len(motion[0]), 0))

    # The certificate.

    def measured(self, at: Any) -> Measured | None:
        """Return the limited quantity at `Samples` of a motion; `Poses` suffice if it is `of_position`."""
        return None

    def margin(self, samples: Samples) -> Margin | None:
        """Return the margin along a motion, if it has one."""
        measured = self.measured(samples)
        return None if measured is None else margin_of(self, measured, samples)

    # The diagnosis: relaxing all limits of the kind together.

    @classmethod
    def scaled(cls, problem: Problem, factor: float) -> Problem:
        """Return a problem with its limits of this kind relaxed by a common factor."""
        return with_limits(problem, **{cls.key: getattr(problem.limits, cls.key) * factor})

    @classmethod
    def without(cls, problem: Problem) -> Problem:
        """Return a problem without its limits of this kind."""
        return with_limits(problem, **{cls.key: free_bounds(len(getattr(problem.limits, cls.key)))})

    @classmethod
    def factor(cls, problem: Problem, motion: Trajectory) -> float | None:
        """Return the factor on the limits of this kind with which a motion keeps them; None if it keeps the limits."""
        over = [m for m in overrun_margins(cls, problem, motion) if np.isfinite(m.value)]
        return cls.factor_of(problem, over) if over else None

    @classmethod
    def factor_of(cls, problem: Problem, over: list[Margin]) -> float | None:
        """Return that factor from the margins that are overrun."""
        ratios = [m.value / m.limit for m in over if m.limit]
        return BETWEEN_NODES_FACTOR * max(ratios) if ratios else None

    @classmethod
    def violation(cls, problem: Problem, motion: Trajectory) -> str | None:
        """Return a sentence on the worst overrun of the limits of this kind; None if a motion keeps them."""
        try:
            over = overrun_margins(cls, problem, motion)
        except AssemblyError:
            return None
        return max(over, key=lambda m: m.overrun.max()).sentence("would have to come to") if over else None

    def narrowed(self, problem: Problem, amount: float) -> Problem:
        """Return a problem with both bounds of this limit moved inwards, if `tightened` is None."""
        return problem


def with_limits(problem: Problem, **changes: Any) -> Problem:
    """Return a problem with other values in its limits."""
    return replace(problem, limits=replace(problem.limits, **changes))


def limited_rows(bounds: np.ndarray) -> list[int]:
    """Return the indices of [low, high] rows with a finite bound."""
    return [int(j) for j in np.flatnonzero(np.isfinite(bounds).any(axis=1))]


def overrun_margins(kind: type[PathLimit], problem: Problem, motion: Trajectory) -> list[Margin]:
    """Return the margins of one kind that a motion overruns."""
    samples = samples_of(problem, motion)
    found = [limit.margin(samples) for limit in kind.of(problem)]
    return [margin for margin in found if margin is not None and not margin.kept]


@np.errstate(invalid="ignore")  # infinity less infinity is not kept either
def margin_of(of: PathLimit, measured: Measured, samples: Samples) -> Margin:
    """Return the margin of a quantity along a motion.

    The least margin of an interval with a kink is that of the samples, without interpolation by parabolas.
    """
    (low, high), points = measured.bounds, samples.points
    values, bent = measured.values, measured.bent
    inside = np.minimum(values - low, high - values)
    at = int(np.argmin(inside))
    limit = high if high - values[at] <= values[at] - low else low
    least = least_between(inside, points)
    if bent is not None:
        rows, kinked = inside.reshape(-1, len(points)), bent.reshape(-1, len(points)).any(axis=1)
        least = np.where(kinked, rows.min(axis=1), least)
    left = float(least.min())
    value = values[at] if not np.isfinite(left) else limit - left if limit == high else limit + left
    return Margin(
        of=of,
        name=measured.name,
        value=float(value),
        limit=float(limit),
        left=left,
        unit=measured.unit,
        time_s=float(samples.time[at]),
        overrun=np.maximum(0.0, -least) / (measured.size or abs(limit) or 1.0),
        upper=bool(limit == high),
    )
