"""The kinds of limits, and the limits of a problem. A new kind is one entry in each of these two tables."""

from linkplan.planner.limits.actuators import ControlLimit, EffortRateLimit, MotorLimit, PowerLimit, RobustLimit
from linkplan.planner.limits.extra import ExtraPathLimit
from linkplan.planner.limits.joints import BallLimit, RangeLimit, SpeedLimit, TendonLimit
from linkplan.planner.limits.loops import ClosureForceLimit, SingularMarginLimit
from linkplan.planner.limits.path_limit import Margin, PathLimit, Problem, Samples
from linkplan.planner.limits.site import SitePathLimit

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
