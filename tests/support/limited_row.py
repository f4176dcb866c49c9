"""A limited quantity without a `Limit`: the facts and the number that margins and tightenings read."""

from dataclasses import dataclass

from linkplan.planner.limits.limit import LimitFacts


@dataclass(frozen=True, slots=True)
class LimitedRow:
    """A row with these facts of the joint, actuator or site with this number."""

    facts: LimitFacts
    item: int
