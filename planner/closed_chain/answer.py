"""The plan of a certified motion: its status by the certificate, its message in words."""

from dataclasses import replace

from linkplan.planner.certificate.collisions import with_contacts
from linkplan.planner.closed_chain.prescribed import reference_demand
from linkplan.planner.plan import Plan, tracking_errors


def finished(problem, trajectory, certificate, objective, history, message: str | None) -> Plan:
    """Return the plan of a certified motion, its status by the certificate and its message in words."""
    certificate = with_contacts(problem, trajectory, certificate)
    plan = Plan(
        problem=problem, status="optimal", message="", objective=objective, trajectory=trajectory, certificate=certificate
    )
    details: dict[str, float] = {}
    sentence = message or f"{problem.objective.name.replace('_', ' ')}-optimal motion of {trajectory.duration_s:.6g} s"
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
        demand = reference_demand(problem, trajectory.start_pose)
        if demand is not None:
            sentence += f"; {demand.sentence('the reference itself')}"
            details |= {"reference_needs": demand.needed, "reference_needs_at_s": demand.time_s}
    if not certificate.passed:
        return replace(
            plan,
            status="failed",
            message=f"failed: the solver converged, the certificate does not pass: {'; '.join(certificate.failures)}",
            history=tuple(history),
            details=details,
        )
    return replace(plan, message=sentence, history=tuple(history), details=details)
