"""The answer to a user's optimal-control problem: a solution with its certificate, or the reason for none."""

from dataclasses import dataclass

from linkplan.models.errors import InfeasibleError
from linkplan.planner.ode.certificate import OdeCertificate
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.ode.trajectory import OdeTrajectory
from linkplan.planner.refinement.history import Step, recorded
from linkplan.planner.refinement.refined import Refined
from linkplan.planner.solvers.outcome import OF_TIME


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class OdePlan:
    """A solution with its certificate, or none and the reason.

    `status` is "optimal", "feasible" (certified, but less exact than was asked, or with an objective that still moves by
    more: `message` says by how much), "infeasible" or "failed".
    """

    problem: OdeProblem
    status: str
    message: str
    objective: float | None = None
    trajectory: OdeTrajectory | None = None
    certificate: OdeCertificate | None = None
    history: tuple[Step, ...] = ()

    def require(self) -> "OdePlan":
        """Return this plan if it is optimal.

        Raises:
            InfeasibleError: carrying the plan, if it is not.
        """
        if self.status != "optimal":
            raise InfeasibleError(self.message, self)
        return self


def plan_without_motion(problem: OdeProblem, status: str, reason: str) -> OdePlan:
    """Return the plan of a problem without a motion, "infeasible" or "failed", with the reason and the time that ran out."""
    return OdePlan(problem=problem, status=status, message=f"{status}: {reason}{_out_of_time(problem)}", history=recorded())


def plan_of(problem: OdeProblem, refined: Refined[OdeTrajectory, OdeCertificate], unbounded: str | None = None) -> OdePlan:
    """Return the plan of a refined motion; `unbounded` are the words on a duration that has no best, where there is none."""
    trajectory, certificate, objective = refined.motion, refined.certificate, refined.solution.objective
    best = f"feasible: the best certified motion, {objective:.10g} in {trajectory.duration_s:.8g} s, keeps every limit"
    if unbounded is not None:
        status, message = "failed", f"failed: {unbounded}"
    elif not certificate.passed:
        status = "failed"
        message = f"failed: the solver converged, the certificate does not pass: {'; '.join(certificate.failures)}"
    elif certificate.integration_error > problem.tolerance:
        status = "feasible"
        message = (
            f"{best}, but the integrated state ends {certificate.integration_error:.3g} of its size from the solution, more"
            f" than the tolerance {problem.tolerance:g}{_moved(refined)}"
        )
    elif not refined.settled:
        status = "feasible"
        message = f"{best}, but objective_tolerance = {problem.objective_tolerance:g} was not reached{_moved(refined)}"
    else:
        status, message = "optimal", f"optimum {objective:.10g} in {trajectory.duration_s:.8g} s"
        if certificate.integration_restarts:
            message += (
                "; the motion is unstable: a small error grows more than ten thousandfold along it, so that only feedback"
                f" can follow it; the integration was restarted {certificate.integration_restarts} time(s)"
            )
    return OdePlan(
        problem=problem,
        status=status,
        message=message if status == "optimal" else message + _out_of_time(problem),
        objective=objective,
        trajectory=trajectory,
        certificate=certificate,
        history=recorded(),
    )


def _out_of_time(problem: OdeProblem) -> str:
    """Return the words on a time limit that has passed; empty before it has."""
    if not problem.solver.deadline.passed:
        return ""
    return f"; the plan ran out of its {problem.solver.max_time_s:g} s {OF_TIME}"


def _moved(refined: Refined[OdeTrajectory, OdeCertificate]) -> str:
    """Return the words on what the objective changed by between the last two meshes whose motions pass."""
    if refined.moved == 0.0:
        return ""
    return f"; its objective changed by {refined.moved:.2g} of itself from mesh to mesh at the last"
