"""The plan of a certified motion: its status from the certificate, and its message."""

from dataclasses import replace

from linkplan.planner.certificate.certificate import Certificate
from linkplan.planner.certificate.collisions import with_contacts
from linkplan.planner.certificate.slow_friction import SLOW_SHARE, slow_share
from linkplan.planner.closed_chain.case import is_exact
from linkplan.planner.closed_chain.prescribed import reference_demand
from linkplan.planner.plan import Plan, tracking_errors
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import SolverSettings
from linkplan.planner.refinement.history import recorded
from linkplan.planner.trajectory import Trajectory

# The first word of an optimal plan's message, unless the phase plane shows that no motion is quicker.
LOCALLY = "locally "


def finished(
    problem: Problem,
    trajectory: Trajectory,
    certificate: Certificate,
    objective: float,
    message: str | None,
    *,
    optimal: bool = True,
) -> Plan:
    """Return the plan of a certified motion; every search and every prescribed motion ends here.

    The plan passes if its certificate, including contacts along the motion, passes and the tolerance is met. Its status is
    then "optimal" if the motion is locally optimal as far as known, else "feasible".
    """
    certificate = with_contacts(problem, trajectory, certificate)
    plan = Plan(
        problem=problem,
        status="optimal" if optimal else "feasible",
        message=message or "",
        objective=objective,
        trajectory=trajectory,
        certificate=certificate,
        history=recorded(),
    )
    failure = _failure(plan)
    details: dict[str, float] = {}
    best = optimality(problem) if optimal else ""
    sentence = message or f"{best}motion of {trajectory.duration_s:.6g} s"
    errors = tracking_errors(plan)
    if errors is not None and message is None and problem.objective.has("tracking"):
        joint = problem.mechanism.independent_joints[0]
        details |= {
            f"tracking_rms_{joint.unit}": joint.shown(errors[0]),
            f"tracking_max_{joint.unit}": joint.shown(errors[1]),
        }
        sentence = (
            f"nearest motion to the reference: {joint.shown(errors[0]):.4g} {joint.unit} rms,"
            f" {joint.shown(errors[1]):.4g} {joint.unit} at most away from it"
        )
        demand = reference_demand(replace(problem, solver=SolverSettings()), trajectory.start_pose)
        if demand is not None:
            sentence += f"; {demand.sentence('the reference itself')}"
            details |= {"reference_needs": demand.needed, "reference_needs_at_s": demand.time_s}
    slow = None if failure is not None else slow_share(problem.mechanism, trajectory)
    if slow is not None and slow[0] > SLOW_SHARE:
        share, joint = slow
        details["slow_friction_share"] = share
        sentence += (
            f"; {joint} is so slow during {share:.0%} of it that less than nine tenths of its dry friction are planned"
            " (a lower mechanism.friction_transition_deg_s plans more)"
        )
    if failure is not None:
        return replace(plan, status="failed", message=f"failed: {failure}", objective=None, details=details)
    return replace(plan, message=sentence, details=details)


def optimality(problem: Problem) -> str:
    """Return the first words of an optimal plan's message: no solver shows more than a local optimum."""
    return f"{LOCALLY}{problem.objective.name.replace('_', ' ')}-optimal "


def _failure(plan: Plan) -> str | None:
    """Return the reason why a motion's certificate fails or its tolerance is missed; else None."""
    certificate, tolerance = plan.certificate, plan.problem.mesh.tolerance_deg
    assert certificate is not None  # of a motion
    if not certificate.passed:
        return f"the solver converged, the certificate does not pass: {'; '.join(certificate.failures)}"
    if tolerance is None or is_exact(plan.problem, certificate):
        return None
    return (
        f"the state integrated under the planned effort ends {certificate.integration_error_deg:.3g} deg from the"
        f" planned state on {plan.intervals} intervals,"
        f" more than mesh.tolerance_deg = {tolerance:g}"
    )
