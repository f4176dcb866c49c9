"""A plan in words: its verdict, the solves that led to it, its certificate."""

import numpy as np

from linkplan.planner.plan import Plan, not_honoured
from linkplan.studies.output.digits import error_figure, figure, known_digits
from linkplan.studies.output.objective_unit import objective_unit
from linkplan.studies.output.tables import table

# Digits of a solve's objective: it is not certified.
_OF_A_STEP = 6


def plan_text(plan: Plan) -> str:
    """Return a plan's verdict and certificate."""
    problem, trajectory, certificate = plan.problem, plan.trajectory, plan.certificate
    lines = [
        f"{problem.name}: {plan.status}",
        plan.message if plan.message[:1].isupper() else plan.message.capitalize()[:1] + plan.message[1:],
    ]
    chosen = [f"note: {text}" for text in problem.notes]
    if trajectory is None or certificate is None:
        return "\n".join([*lines, *chosen])
    digits = known_digits(plan)
    lines.append(f"duration {figure(trajectory.duration_s, digits)} s, {plan.scheme}, {plan.intervals} intervals")
    if plan.objective is not None:
        lines.append(f"objective ({problem.objective.name}): {figure(plan.objective, digits)}{objective_unit(problem)}")
    lines += _history_lines(plan, digits)
    for actuator, peak, (low, high) in zip(
        problem.mechanism.actuators, certificate.peak_effort, problem.limits.effort, strict=True
    ):
        limit = f"limit {low:g} to {high:g} {actuator.unit}"
        lines.append(f"effort {actuator.name}: {peak:.5g} {actuator.unit} at the most, {limit}")
    units = " or ".join(dict.fromkeys(actuator.unit for actuator in problem.mechanism.actuators))
    rows = [
        ["effort beyond its limit, any instant", error_figure(certificate.effort_excess), units],
        ["inverse dynamics minus planned effort", error_figure(certificate.dynamics_residual), units],
        *(["closure gap", error_figure(gap), unit] for unit, gap in (certificate.closure_gaps or {"m": 0.0}).items()),
    ]
    if certificate.integration_restarts:
        lines.append(
            "the motion is unstable: a small error grows more than ten thousandfold along it, so that only feedback can"
            f" follow it; the integration was restarted {certificate.integration_restarts} time(s)"
        )
    kinds = {joint.kind for joint in problem.mechanism.independent_joints}
    if "hinge" in kinds:
        rows.append(["state after integration at 1e-12", error_figure(certificate.integration_error_deg), "deg"])
    if "slide" in kinds:
        rows.append(["state after integration at 1e-12", error_figure(certificate.integration_error_m), "m"])
    for joint, margin in zip(problem.mechanism.joints, certificate.position_margin, strict=True):
        if np.isfinite(margin):
            rows.append([f"margin to the range of {joint.name}", joint.shown(margin), joint.unit])
    for joint, margin in zip(problem.mechanism.joints, certificate.speed_margin, strict=True):
        if np.isfinite(margin):
            rows.append([f"margin to the speed limit of {joint.name}", joint.shown(margin), f"{joint.unit}/s"])
    if problem.motion.start_at or problem.motion.goal_at or any(waypoint.at for waypoint in problem.motion.waypoints):
        rows.append(["sites from where start, waypoints and goal ask them", error_figure(certificate.site_error_m), "m"])
    rows.append(["least det J_z, relative to home", certificate.singularity_ratio, "1"])
    rows += [[f"margin to the limit on {m.title}", m.left, m.unit or "1"] for m in certificate.margins]
    forces = zip(problem.mechanism.closure_names, certificate.peak_closure_force, strict=True)
    rows += [[f"largest closure force of {name}", force, "N"] for name, force in forces]
    powers = zip(problem.mechanism.actuators, certificate.peak_power, strict=True)
    rows += [[f"largest power of {actuator.name}", power, "W"] for actuator, power in powers]
    lines += [
        "",
        f"certificate: {'passed' if certificate.passed else 'NOT passed'}",
        table(["between the nodes", "worst", "unit"], rows),
    ]
    lines += [*chosen, *(f"note: {text}" for text in not_honoured(plan))]
    return "\n".join(lines)


def _history_lines(plan: Plan, digits: int) -> list[str]:
    """Return a line for each solve that led to a plan, where it took more than one."""
    if len(plan.history) < 2:
        return []
    lines = ["solves:"]
    for step in plan.history:
        error = "" if not step.integration_error_deg else f", {step.integration_error_deg:.2g} deg after integration"
        answer = (
            f"objective {figure(step.objective, min(digits, _OF_A_STEP))}"
            if step.converged
            else f"not solved ({step.solver_status})"
        )
        lines.append(f"  {step.what}: {step.scheme}, {step.intervals} intervals, {answer}{error}, {step.solve_s:.2g} s")
    return lines
