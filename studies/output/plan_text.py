"""The text of a plan: its verdict, the solves before it, its certificate."""

import numpy as np

from linkplan.planner.certificate.certificate import Certificate
from linkplan.planner.plan import Plan, not_honoured
from linkplan.studies.output.digits import error_figure, figure, known_digits
from linkplan.studies.output.objective_unit import objective_unit
from linkplan.studies.output.tables import table


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
    if certificate.integration_restarts:
        lines.append(
            "the motion is unstable: a small error grows more than ten thousandfold along it, so that only feedback can"
            f" follow it; the integration was restarted {certificate.integration_restarts} time(s)"
        )
    lines += [
        "",
        f"certificate: {'passed' if certificate.passed else 'NOT passed'}",
        table(["between the nodes", "worst", "unit"], [*_error_rows(plan, certificate), *_margin_rows(plan, certificate)]),
    ]
    lines += [*chosen, *(f"note: {text}" for text in not_honoured(plan))]
    return "\n".join(lines)


def _error_rows(plan: Plan, certificate: Certificate) -> list[list]:
    """Return the rows of the certificate's excess of effort, residuals, gaps and integration errors."""
    mechanism = plan.problem.mechanism
    units = " or ".join(dict.fromkeys(actuator.unit for actuator in mechanism.actuators))
    kinds = {joint.kind for joint in mechanism.independent_joints}
    errors = {"hinge": (certificate.integration_error_deg, "deg"), "slide": (certificate.integration_error_m, "m")}
    return [
        ["effort beyond its limit, any instant", error_figure(certificate.effort_excess), units],
        ["inverse dynamics minus planned effort", error_figure(certificate.dynamics_residual), units],
        *(["closure gap", error_figure(gap), unit] for unit, gap in (certificate.closure_gaps or {"m": 0.0}).items()),
        *(
            ["state after integration at 1e-12", error_figure(error), unit]
            for kind, (error, unit) in errors.items()
            if kind in kinds
        ),
    ]


def _margin_rows(plan: Plan, certificate: Certificate) -> list[list]:
    """Return the rows of the certificate's margins, largest closure forces and powers."""
    motion, mechanism, rows = plan.problem.motion, plan.problem.mechanism, []
    for what, per, margins in (("range", "", certificate.position_margin), ("speed limit", "/s", certificate.speed_margin)):
        rows += [
            [f"margin to the {what} of {joint.name}", joint.shown(margin), f"{joint.unit}{per}"]
            for joint, margin in zip(mechanism.joints, margins, strict=True)
            if np.isfinite(margin)
        ]
    if motion.start_at or motion.goal_at or any(waypoint.at for waypoint in motion.waypoints):
        rows.append(["error of sites at start, waypoints and goal", error_figure(certificate.site_error_m), "m"])
    rows.append(["least det J_z, relative to home", certificate.singularity_ratio, "1"])
    rows += [[f"margin to the limit on {m.title}", m.left, m.unit or "1"] for m in certificate.margins]
    forces = zip(mechanism.closure_names, certificate.peak_closure_force, strict=True)
    rows += [[f"largest closure force of {name}", force, "N"] for name, force in forces]
    powers = zip(mechanism.actuators, certificate.peak_power, strict=True)
    return [*rows, *([f"largest power of {actuator.name}", power, "W"] for actuator, power in powers)]


def _history_lines(plan: Plan, digits: int) -> list[str]:
    """Return a line for each solve before a plan, if there were several."""
    if len(plan.history) < 2:
        return []
    lines = ["solves:"]
    for step in plan.history:
        error = "" if not step.integration_error_deg else f", {step.integration_error_deg:.2g} deg after integration"
        answer = f"not solved ({step.solver_status})"
        if step.converged:
            answer = f"objective {figure(step.objective, min(digits, 6))}"
        lines.append(f"  {step.what}: {step.scheme}, {step.intervals} intervals, {answer}{error}, {step.solve_s:.2g} s")
    return lines
