"""What the commands print for people: a few lines and tables per result."""

import numpy as np

from planner.objective import TERMS
from planner.plan import Plan, not_honoured
from planner.problem import PlanningProblem
from studies.compare import Comparison, rollout_record
from studies.inspection import Inspection, branch
from studies.tables import table


def inspection_text(found: Inspection) -> str:
    """Return the loop report of a mechanism."""
    mechanism = found.mechanism
    n_rows = mechanism.n_closure_rows
    lines = [
        f"{mechanism.name}: {mechanism.dof} degree{'s' if mechanism.dof != 1 else ''} of freedom"
        f" ({', '.join(j.name for j in mechanism.independent_joints)} independent of {mechanism.n_q} joints)",
        f"closure: {', '.join(mechanism.closure_names) or 'none'}: {n_rows} rows, rank {len(mechanism.closure_rows)},"
        f" gap {found.closure_gap_m:.3g} m",
        "home: "
        + ", ".join(f"{j.name} = {j.shown(x):.5g} {j.unit}" for j, x in zip(mechanism.joints, mechanism.home, strict=True)),
    ]
    if found.mechanism.closures:
        lines.append(f"branch: that of home, where det J_z is {', '.join(f'{x:.4g}' for x in branch(mechanism))}")
    for joint, can in zip(mechanism.independent_joints, found.reaches, strict=True):
        lines.append(
            f"reach: {joint.name} from {joint.shown(can.lower.position):.5g} ({can.lower.reason})"
            f" to {joint.shown(can.upper.position):.5g} {joint.unit} ({can.upper.reason})"
        )
    lines += [f"actuator: {a.name} on {a.target}, {a.lower:g} to {a.upper:g} {a.unit}" for a in mechanism.actuators]
    lines += [f"note: {note}" for note in found.notes]
    if found.points:
        lines += ["", _points_table(found)]
    lines += ["", *(f"PROBLEM: {problem}" for problem in found.problems)] if found.problems else ["no problems found"]
    return "\n".join(lines)


def _points_table(found: Inspection) -> str:
    mechanism = found.mechanism
    independent = mechanism.independent_joints
    head = [f"{j.name} [{j.unit}]" for j in mechanism.joints]
    head += [f"M_{a.name}{b.name}" for i, a in enumerate(independent) for b in independent[i:]]
    head += [f"gravity {j.name} [{'N.m' if j.kind == 'hinge' else 'N'}]" for j in independent]
    head += [f"hold {j.name} [{'N.m' if j.kind == 'hinge' else 'N'}]" for j in independent]
    head += [f"{a.name}->{j.name}" for a in mechanism.actuators for j in independent]
    rows = []
    for point in found.points:
        upper = point.reduced_inertia[np.triu_indices(mechanism.dof)]
        positions = [j.shown(x) for j, x in zip(mechanism.joints, point.pose, strict=True)]
        efforts = [*point.gravity_effort, *point.holding_effort, *point.effort_map.T.ravel()]
        rows.append([float(x) for x in [*positions, *upper, *efforts]])
    return table(head, rows)


def plan_text(plan: Plan) -> str:
    """Return a plan's verdict and certificate."""
    problem, trajectory, certificate = plan.problem, plan.trajectory, plan.certificate
    lines = [
        f"{problem.name}: {plan.status}",
        plan.message if plan.message[:1].isupper() else plan.message.capitalize()[:1] + plan.message[1:],
    ]
    if trajectory is None or certificate is None:
        return "\n".join(lines)
    lines.append(f"duration {trajectory.duration_s:.8g} s, {plan.scheme}, {plan.intervals} intervals")
    if plan.objective is not None:
        lines.append(f"objective ({problem.objective.name}): {plan.objective:.9g}{_objective_unit(problem)}")
    lines += _history_lines(plan)
    for actuator, peak, (low, high) in zip(
        problem.mechanism.actuators, certificate.peak_effort, problem.limits.effort, strict=True
    ):
        lines.append(f"effort {actuator.name}: {peak:.5g} {actuator.unit} at the most, limit {low:g} to {high:g}")
    rows = [
        ["effort beyond its limit, any instant", certificate.effort_excess, "unit of effort"],
        ["inverse dynamics less carried effort", certificate.dynamics_residual, "unit of effort"],
        ["loop gap", certificate.closure_gap_m, "m"],
    ]
    if certificate.integration_restarts:
        lines.append(
            "the motion is unstable: a small error grows more than ten thousandfold along it, so that only feedback can"
            f" follow it; integration was begun anew {certificate.integration_restarts} time(s)"
        )
    kinds = {joint.kind for joint in problem.mechanism.independent_joints}
    if "hinge" in kinds:
        rows.append(["state after integration at 1e-12", certificate.integration_error_deg, "deg"])
    if "slide" in kinds:
        rows.append(["state after integration at 1e-12", certificate.integration_error_m, "m"])
    for joint, margin in zip(problem.mechanism.joints, certificate.position_margin, strict=True):
        if np.isfinite(margin):
            rows.append([f"margin to the range of {joint.name}", joint.shown(margin), joint.unit])
    for joint, margin in zip(problem.mechanism.joints, certificate.speed_margin, strict=True):
        if np.isfinite(margin):
            rows.append([f"margin to the speed limit of {joint.name}", joint.shown(margin), f"{joint.unit}/s"])
    rows.append(["least det J_z, of that at home", certificate.singularity_ratio, "1"])
    rows += [[f"left of {m.title}", m.left, m.unit or "1"] for m in certificate.margins]
    forces = zip(problem.mechanism.closure_names, certificate.peak_closure_force, strict=True)
    rows += [[f"largest closure force of {name}", force, "N"] for name, force in forces]
    powers = zip(problem.mechanism.actuators, certificate.peak_power, strict=True)
    rows += [[f"largest power of {actuator.name}", power, "W"] for actuator, power in powers]
    lines += [
        "",
        f"certificate: {'passed' if certificate.passed else 'NOT passed'}",
        table(["between the nodes", "worst", "unit"], rows),
    ]
    lines += [f"note: {text}" for text in not_honoured(plan)]
    return "\n".join(lines)


def _objective_unit(problem: PlanningProblem) -> str:
    """Return the unit of a single term, in front a blank; nothing for a sum."""
    terms = list(problem.objective.weights)
    return f" {TERMS[terms[0]][1]}" if len(terms) == 1 else ""


def _history_lines(plan: Plan) -> list[str]:
    """Return a line for each solve that led to a plan, where it took more than one."""
    if len(plan.history) < 2:
        return []
    lines = ["solves:"]
    for step in plan.history:
        error = "" if not step.integration_error_deg else f", {step.integration_error_deg:.2g} deg after integration"
        answer = f"objective {step.objective:.9g}" if step.converged else f"not solved ({step.solver_status})"
        lines.append(f"  {step.what}: {step.scheme}, {step.intervals} intervals, {answer}{error}, {step.solve_s:.2g} s")
    return lines


def comparison_text(comparison: Comparison) -> str:
    """Return the trackers side by side."""
    plan = comparison.plan
    lines = []
    units = list(dict.fromkeys(joint.unit for joint in plan.problem.mechanism.independent_joints))
    cases = [(comparison.title, comparison.nominal)]
    if comparison.mismatch is not None:
        cases.append((comparison.mismatch.name, comparison.mismatched))
    for title, runs in cases:
        conditions = next(iter(runs.values())).conditions
        lines += [
            "",
            f"{plan.problem.name}, {title}: MuJoCo {conditions['mujoco']}, {conditions['integrator']},"
            f" step {conditions['timestep_s']:g} s, control period {conditions['control_period_s']:g} s",
        ]
        rows = []
        for name, rollout in runs.items():
            record = rollout_record(plan, rollout)
            rows.append(
                [
                    name,
                    *(record[f"{which}_error_{unit}"] for unit in units for which in ("rms", "max", "final")),
                    max(record["peak_effort"].values()),
                    100 * record["saturated_fraction"],
                    1e6 * record["loop_gap_max_m"],
                    record["stable"],
                ]
            )
        effort = plan.problem.mechanism.actuators[0].unit
        head = [
            "tracker",
            *(f"{which} [{unit}]" for unit in units for which in ("rms", "max", "final")),
            f"peak [{effort}]",
            "saturated [%]",
            "gap [um]",
            "stable",
        ]
        lines.append(table(head, rows))
    return "\n".join(lines[1:])
