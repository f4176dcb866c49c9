"""The plan of a certified motion: its status from the certificate, and its message; and the plan of a prescribed motion."""

from dataclasses import replace

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import joint_rates
from linkplan.models.poses.assembly import follow
from linkplan.models.tree.friction import frictions_of
from linkplan.planner.certificate.certificate import Certificate, certify
from linkplan.planner.certificate.collisions import with_contacts
from linkplan.planner.closed_chain.case import is_exact
from linkplan.planner.closed_chain.prescribed import highest_frequency, prescribe, reference_demand, rounded_down
from linkplan.planner.plan import Plan, tracking_errors
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import SolverSettings
from linkplan.planner.refinement.history import progress, recorded
from linkplan.planner.trajectory import Trajectory

# The first word of an optimal plan's message, unless the phase plane shows that no motion is quicker.
LOCALLY = "locally "


def slow_share(mechanism: Mechanism, trajectory: Trajectory) -> tuple[float, str] | None:
    """Return the largest share of a motion during which a joint moves too slowly for its dry friction, and the joint's name.

    Too slow means that f tanh(v / v_0) is below 0.9 f. None if no joint has dry friction.
    """
    joints = [one for one in frictions_of(mechanism.model) if one.dof is not None]
    if not joints:
        return None
    time = np.linspace(trajectory.breaks_s[0], trajectory.breaks_s[-1], 400)
    poses = follow(mechanism, trajectory.position_at(time), trajectory.start_pose)
    qvel = mechanism.qvel_of(poses, joint_rates(mechanism, poses, trajectory.velocity_at(time)))
    found = []
    for one in joints:
        speed = np.abs(qvel[:, one.dof])
        fast = np.arctanh(0.9) * mechanism.friction_transition * (1.0 if one.turns else mechanism.extent_m)
        found.append((float(np.mean(speed < fast)) if speed.max() > 1e-9 else 0.0, one.name))  # the loops may hold the joint
    return max(found)


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
    if slow is not None and slow[0] > 0.1:  # less are its start, end and turning points
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


def plan_prescribed(problem: Problem, start_pose: np.ndarray) -> Plan:
    """Return the plan of a reference that must be followed exactly."""
    progress("following the reference")
    demand = reference_demand(problem, start_pose)
    if demand is not None:
        progress("looking for the highest feasible frequency")
        frequency = highest_frequency(problem, start_pose)
        details = {"needed": demand.needed, "limit": demand.limit, "time_s": demand.time_s}
        remedy = "no slower one keeps the limits"
        if frequency is not None:
            details["highest_frequency_hz"] = frequency
            remedy = f"up to {rounded_down(frequency):g} Hz it keeps every limit"
        return Plan(
            problem=problem,
            status="infeasible",
            message=f"infeasible: {demand.sentence('following the reference exactly')}; at this amplitude {remedy};"
            ' motion.kind = "periodic" plans the nearest motion that keeps them',
            details=details,
        )
    trajectory = prescribe(problem, start_pose)
    certificate = certify(problem, trajectory)
    return finished(problem, trajectory, certificate, 0.0, "the reference keeps every limit and is followed exactly")
