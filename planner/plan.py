"""The answer to a planning problem: a motion with its certificate, or the reason why there is none."""

from dataclasses import dataclass, field, fields

import numpy as np

from linkplan.models.errors import InfeasibleError
from linkplan.planner.certificate.certificate import Certificate
from linkplan.planner.certificate.collisions import contact_note
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.history import Step
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.collocation import Transcribed

# The legal values of a plan's status, and those of plans with a motion that passes.
STATUSES, PASSED = ("optimal", "feasible", "infeasible", "failed"), ("optimal", "feasible")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Plan:
    """A motion with its certificate, or the reason why there is none.

    `status` is one of `STATUSES`: "optimal" (converged and certified), "feasible" (certified, but not known to be locally
    optimal), "infeasible" (no motion keeps the limits) or "failed" (no answer was found). `message` explains it in a
    sentence. `objective` is in SI: effort [N2 m2 s or N2 s], time [s], tracking [rad2 s or m2 s]. `details` holds further
    values by name, with the unit in the name. `solved` is the last program with its solution as the starting point, for
    warm starts; None for a motion that needed no solver.
    """

    problem: Problem
    status: str
    message: str
    objective: float | None = None
    trajectory: Trajectory | None = None
    certificate: Certificate | None = None
    history: tuple[Step, ...] = ()
    details: dict[str, float] = field(default_factory=dict)
    solved: Transcribed | None = None
    solved_again: bool = False  # by a warm start of an existing program

    def __reduce__(self) -> tuple:
        """Pickle without the program, which a saved plan does not have either."""
        kept = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "solved"}
        return _unpickled, (kept,)

    @property
    def passed(self) -> bool:
        """Whether it has a motion that passes its certificate, optimal or not."""
        return self.status in PASSED

    def require(self) -> "Plan":
        """Return this plan if its motion passes its certificate.

        Raises:
            InfeasibleError: carrying the plan, if it does not.
        """
        if not self.passed:
            raise InfeasibleError(self.message, self)
        return self

    @property
    def scheme(self) -> str:
        """The transcription of the final mesh; the problem's if nothing was solved."""
        return self.problem.mesh.scheme if self.solved is None else self.solved.scheme.name

    @property
    def intervals(self) -> int:
        """The number of intervals of the final mesh; the problem's if there is no motion."""
        if self.trajectory is None:
            return self.problem.mesh.intervals
        return len(self.trajectory.breaks_s) - 1


def _unpickled(kept: dict) -> Plan:
    return Plan(**kept)


def not_honoured(plan: Plan) -> tuple[str, ...]:
    """Return phrases on what a plan neglects of its model: the problem's list, and contacts along the motion."""
    contacts = () if plan.certificate is None else plan.certificate.contacts
    return (*plan.problem.not_honoured, *(contact_note(meeting) for meeting in contacts))


def tracking_errors(plan: Plan) -> tuple[float, float] | None:
    """Return the rms and largest distance [rad or m] of a plan from its reference, or None without one."""
    reference, trajectory = plan.problem.reference, plan.trajectory
    if reference is None or trajectory is None:
        return None
    time = trajectory.dense_times(16)
    error = np.linalg.norm(trajectory.position_at(time) - reference.derivative(time), axis=1)
    return float(np.sqrt(np.mean(error**2))), float(error.max())
