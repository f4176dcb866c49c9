"""The pool of known motions: certified motions between a problem's states within its limits, each of its own duration.

They are starts of later searches and bounds of every verdict: no problem is infeasible in a duration for which one is known,
and where the mechanism may rest at the start or the goal, none costs more than a shorter one and the rest.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from linkplan.planner.plan import Plan
from linkplan.planner.trajectory import Trajectory


@dataclass(frozen=True, eq=False, slots=True)
class KnownMotions:
    """Certified motions, in the order in which they were found, and the plans that were looked for once."""

    motions: list[Trajectory] = field(default_factory=list)
    sought: dict[str, Plan | None] = field(default_factory=dict)

    def add(self, motion: Trajectory) -> None:
        """Add a motion whose certificate passed."""
        self.motions.append(motion)

    def once(self, what: str, look: Callable[[], Plan | None]) -> Plan | None:
        """Return the plan that `look` finds, which is called once for each `what`; a motion that passes is added."""
        if what not in self.sought:
            plan = look()
            self.sought[what] = plan
            if plan is not None and plan.passed:
                self.add(plan.require_motion("know"))
        return self.sought[what]

    def shorter_than(self, duration_s: float) -> list[Trajectory]:
        """Return the motions that take less than a duration [s], the longest first."""
        shorter = [motion for motion in self.motions if motion.duration_s < duration_s]
        return sorted(shorter, key=lambda motion: -motion.duration_s)
