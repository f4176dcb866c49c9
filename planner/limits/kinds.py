"""The kinds of limits, and the limits of a problem. A new kind is one entry in each of the two tables."""

import numpy as np

from linkplan.planner.limits.accelerations import AccelerationLimit, SiteAccelerationLimit
from linkplan.planner.limits.actuators import (
    ControlLimit,
    MotorLimit,
    PowerLimit,
)
from linkplan.planner.limits.body import BodyAngleLimit
from linkplan.planner.limits.efforts import EffortLimit, EffortRateLimit, RobustLimit
from linkplan.planner.limits.extra import ExtraPathLimit
from linkplan.planner.limits.jerks import JerkLimit, SiteJerkLimit
from linkplan.planner.limits.joints import (
    BallLimit,
    ClosureForceLimit,
    RangeLimit,
    SingularMarginLimit,
    SpeedLimit,
    TendonLimit,
)
from linkplan.planner.limits.limit import Limit, Margin, Problem, Samples, WhichJoints, limit_margin
from linkplan.planner.limits.site import SitePathLimit
from linkplan.planner.limits.site_path import OnPathLimit
from linkplan.planner.problem.instant import unit_scales

# In the order of their rows in a program.
KINDS: tuple[type[Limit], ...] = (
    EffortLimit,
    RangeLimit,
    EffortRateLimit,
    SpeedLimit,
    AccelerationLimit,
    JerkLimit,
    MotorLimit,
    PowerLimit,
    ClosureForceLimit,
    SingularMarginLimit,
    ControlLimit,
    TendonLimit,
    BallLimit,
    RobustLimit,
    SitePathLimit,
    BodyAngleLimit,
    SiteAccelerationLimit,
    SiteJerkLimit,
    OnPathLimit,
    ExtraPathLimit,
)
# In the order in which a diagnosis removes them to find the one that forbids a motion. Effort limits and joint ranges follow
# after these.
RELAXED: tuple[type[Limit], ...] = (
    RobustLimit,
    JerkLimit,
    SiteJerkLimit,
    SiteAccelerationLimit,
    AccelerationLimit,
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
    OnPathLimit,
    BodyAngleLimit,
    ExtraPathLimit,
)


def limits_of(problem: Problem, *, enclosed: bool = False, position_rows: WhichJoints = False) -> tuple[Limit, ...]:
    """Return a problem's limits; the arguments are those of `Limit.of`."""
    return tuple(limit for kind in KINDS for limit in kind.of(problem, enclosed=enclosed, position_rows=position_rows))


def structure_of(problem: Problem) -> tuple:
    """Return the structure of a problem's limits: its limits, and which of their ends are finite."""
    ones = unit_scales(problem.mechanism)
    return tuple((type(limit), limit, *np.isfinite(limit.bounds(problem, ones))) for limit in limits_of(problem))


def relaxed_kinds(problem: Problem) -> list[type[Limit]]:
    """Return the kinds of limits of a problem that a diagnosis may remove, in its order."""
    return [kind for kind in RELAXED if kind.of(problem)]


def margins_along(samples: Samples) -> tuple[Margin, ...]:
    """Return the margins of all limits along a motion but those of efforts, which the certificate compares with needs."""
    return tuple(limit_margin(limit, samples) for limit in limits_of(samples.problem) if not isinstance(limit, EffortLimit))


def without(kind: type[Limit], problem: Problem) -> Problem:
    """Return a problem without its limits of a kind."""
    return kind.relaxed(problem, np.inf)
