"""A plan as a document: its verdict, its figures, the solves before it, its certificate.

Figures are printed with their known digits.
"""

import contextlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from msgspec.structs import replace

from linkplan.models.errors import AssemblyError
from linkplan.planner.certificate.certificate import Certificate
from linkplan.planner.certificate.demands import demands_of, operating_points, shown_speed
from linkplan.planner.limits.kinds import affine_limits, all_effort_bounds, effort_bounds, limits_of
from linkplan.planner.limits.samples import samples_of
from linkplan.planner.plan.plan import Plan, not_honoured
from linkplan.planner.problem.problem import Problem
from linkplan.planner.proof.finding import Finding, Proof
from linkplan.planner.refinement.history import Step
from linkplan.planner.search.sensitivities import sensitivities_of
from linkplan.studies.output.certificate_list import certificate_list
from linkplan.studies.output.document import Axis, Block, Facts, NumberText, Plane, Series, Table, Text, table_of
from linkplan.studies.output.numbers import drawn_rows, rounded
from linkplan.studies.output.text import brief_rows, checks, limits_text, notes_of

# Solvers stop at a relative error of 1e-8. A certificate passes if the relative error is at most about 1e-3.
_MAX_DIGITS, _MIN_DIGITS = 8, 3
_TITLES = {
    "refuted": "Refuted: the motion violates these",
    "undecided": "Undecided: these are neither proved nor refuted",
    "proved": "Proved at every instant, for the model and the polynomials of the plan",
}
# The heads of the fields of a `Demand`, and of a `Step`.
_DEMAND_HEADS = {
    "actuator": "actuator", "peak_effort": "peak effort", "rms_effort": "rms effort", "effort_unit": "unit",
    "peak_speed": "peak speed", "speed_unit": "its unit", "peak_motor_power_w": "power as motor [W]",
    "peak_brake_power_w": "as brake [W]", "energy_given_j": "energy given [J]", "energy_taken_j": "taken [J]",
}  # fmt: skip
_STEP_HEADS = {
    "what": "what was tried", "scheme": "scheme", "intervals": "intervals", "segments": "segments", "converged": "solved",
    "solver_status": "solver's answer", "objective": "objective [SI]", "integration_error_deg": "integration error [deg]",
    "build_s": "time to build [s]", "solve_s": "time to solve [s]",
}  # fmt: skip
# The tables of a proof that a summary of a plan has too.
_OPEN_TITLES = (_TITLES["refuted"], _TITLES["undecided"])


def objective_digits(plan: Plan) -> int:
    """Return the number of known digits of a plan's duration and objective, from its integration error.

    The error of the integrated state as a share of the joints' travel is about the relative error of the motion's figures.
    """
    trajectory, certificate = plan.trajectory, plan.certificate
    if trajectory is None or certificate is None:
        return _MIN_DIGITS
    travelled = np.ptp(trajectory.position_at(trajectory.dense_times(4)), axis=0)
    shares, error_rad = [], np.radians(certificate.integration_error_deg)
    for kind, error in (("hinge", error_rad), ("slide", certificate.integration_error_m)):
        of_kind = [x for x, j in zip(travelled, plan.problem.mechanism.independent_joints, strict=True) if j.kind == kind]
        if of_kind and max(of_kind) > 0 and np.isfinite(error):
            shares.append(error / max(of_kind))
    share = max(shares, default=1.0)
    return int(np.clip(np.floor(-np.log10(max(share, 10.0**-_MAX_DIGITS))), _MIN_DIGITS, _MAX_DIGITS))


def figure(value: float, digits: int) -> str:
    """Return a number with `digits` significant digits; positive ones below 1e-14 are rounding errors."""
    return "< 1e-14" if 0 < value < 1e-14 else f"{value:.{digits}g}"


def radius_figure(radius: float | None) -> str:
    """Return the radius of a sampled loop's pole as text; near the unit circle as its distance, such as "1-2.3e-05"."""
    if radius is None:
        return "-"
    beyond = radius - 1.0
    return NumberText.of(f"1{beyond:+.1e}" if 0 < abs(beyond) < 5e-4 else figure(radius, 4), radius)


def objective_unit(problem: Problem) -> str:
    """Return the unit of a single term, after a space; an empty string for a sum of terms."""
    return f" {problem.objective_unit}".rstrip()


def sensitivity_blocks(plan: Plan) -> list[Block]:
    """Return the table of the objective's slopes by the numbers of the machine; empty without any."""
    found = sensitivities_of(plan)
    if not found:
        return []
    unit = plan.problem.objective_unit or "1"
    heads = [("number", ""), ("value", "SI"), ("slope", f"{unit} per SI"), ("by 1 %", unit), ("by the tolerance", unit)]
    rows = [[one.name, one.value, one.slope, one.by_one_percent, one.by_tolerance] for one in found]
    return [table_of(f"Slopes of the objective ({plan.problem.objective.name}) by numbers of the machine", heads, rows)]


def plan_blocks(plan: Plan) -> list[Block]:
    """Return a plan's verdict and certificate."""
    certificate, message = plan.certificate, plan.message[:1].upper() + plan.message[1:]
    blocks: list[Block] = [
        Text(text=f"{plan.problem.name}: {plan.status}", tone="good" if plan.passed else "plain"),
        Text(text=message),
    ]
    names = names_in(plan)
    notes = notes_of([*plan.problem.notes, *not_honoured(plan)], names)
    if plan.trajectory is None or certificate is None:
        return [*blocks, *notes]
    blocks += [_facts(plan), *([replace(solves(plan), brief=[])] if len(plan.history) > 1 else [])]
    if certificate.integration_restarts:
        text = (
            "the motion is unstable: small errors grow more than ten thousandfold, so only feedback can follow it; the"
            f" integration was restarted {certificate.integration_restarts} time(s)"
        )
        blocks.append(Text(text=text))
    table, demands = replace(checks(certificate_list(plan)), brief=[]), []
    proof = [
        replace(block, brief=[]) if isinstance(block, Table) and block.title not in _OPEN_TITLES else block
        for block in proof_blocks(plan.proof, names)
    ]
    with contextlib.suppress(AssemblyError):  # the loops are open: see the certificate
        demands = [demand_table(plan)]
    return [*blocks, _verdict(plan, certificate), table, *demands, *proof, *notes]


def demand_table(plan: Plan) -> Table:
    """Return the demands of a plan with a motion, an actuator in a row."""
    demands = demands_of(plan.problem, plan.require_motion("judge actuators by"))
    rows = [[getattr(one, field) for field in _DEMAND_HEADS] for one in demands]
    return table_of("Demands of the motion on each actuator", [*_DEMAND_HEADS.values()], rows, brief=[])


def demand_blocks(plan: Plan, group: str) -> list[Block]:
    """Return the table of demands, and the chart of each actuator's effort over its speed with its limits."""
    problem, motion = plan.problem, plan.require_motion("draw")
    time = motion.dense_times(20)
    speed, effort, _ = operating_points(problem, motion, time)
    found: list[Block] = [demand_table(plan)]
    for j, actuator in enumerate(problem.mechanism.actuators):
        per_unit, unit = shown_speed(actuator.si_units[0])
        rows = drawn_rows(np.column_stack([speed[:, j], effort[:, j]]))
        fastest = 1.15 * per_unit * float(np.abs(speed[:, j]).max()) or 1.0
        curves = [
            Series(name="limit" if first else "", x=[-fastest, fastest], y=[end, end], look="dash", colour=4)
            for first, end in zip((True, False), effort_bounds(problem)[j].tolist(), strict=True)
            if np.isfinite(end)
        ]
        motor = problem.motors[j]
        if motor is not None and motor.line is not None:
            stall, no_load = motor.line[0], per_unit * motor.line[1]
            ends = np.array([-fastest, fastest])
            curves += [
                Series(
                    name="torque-speed line" if side > 0 else "",
                    x=rounded(ends),
                    y=rounded(stall * (side - ends / no_load)),
                    look="dots",
                    colour=1,
                )
                for side in (1, -1)
            ]
        planned = Series(
            name="planned",
            x=rounded(per_unit * speed[rows, j]),
            y=rounded(effort[rows, j]),
            colour=None,
            width=2.2,
        )
        found.append(
            Plane(
                title=f"Effort of {actuator.name} over its speed",
                x_axis=Axis(label=f"speed of {actuator.name}", unit=unit),
                y_axis=Axis(label=f"effort of {actuator.name}", unit=actuator.unit),
                curves=[*curves, planned],
                group=group,
                track=len(curves),
                track_times=rounded(time[rows] - motion.breaks_s[0]),
                period=motion.duration_s if motion.periodic else None,
            )
        )
    return found


def _verdict(plan: Plan, certificate: Certificate) -> Text:
    """Return the certificate's verdict, with the excess of efforts and the errors of the integrated motion."""
    kinds = {joint.kind for joint in plan.problem.mechanism.independent_joints}
    apart = {"hinge": (certificate.integration_error_deg, "deg"), "slide": (certificate.integration_error_m, "m")}
    errors = " and ".join(f"{figure(error, 2)} {unit}" for kind, (error, unit) in apart.items() if kind in kinds)
    units = " or ".join(dict.fromkeys(actuator.unit for actuator in plan.problem.mechanism.actuators))
    excess = f"{figure(certificate.effort_excess, 2)} {units}"
    verdict = "passed" if certificate.passed else "NOT passed"
    text = f"certificate: {verdict}; efforts {excess} over their limits, end state {errors} off"
    return Text(text=text, tone="plain" if certificate.passed else "bad")


def names_in(plan: Plan) -> list[str]:
    """Return the names in the rows of a plan that differ only in names."""
    mechanism = plan.problem.mechanism
    return [*(a.name for a in mechanism.actuators), *(j.name for j in mechanism.joints), *mechanism.closure_names]


def _facts(plan: Plan) -> Facts:
    """Return the facts of a plan; in brief, only with the actuator whose peak is the largest share of its limit."""
    rows, actuators = facts(plan), plan.problem.mechanism.actuators
    split = len(rows) - len(actuators)
    first, efforts = rows[:split], rows[split:]
    peaks = zip(plan.certificate.peak_effort, effort_bounds(plan.problem), strict=True)
    margins = [(-peak / (max(-low, high) or np.inf), -peak) for peak, (low, high) in peaks]
    brief, least = brief_rows(efforts, margins, [a.unit for a in actuators], names_in(plan)), least_margin(plan)
    return Facts(rows=[*rows, least], brief=None if brief is None else [*first, *(tuple(row) for row in brief), least])


def facts(plan: Plan) -> list[tuple[str, str]]:
    """Return the duration, the objective and the largest efforts of a plan with a motion, each with its unit."""
    problem, digits = plan.problem, objective_digits(plan)
    duration = figure(plan.trajectory.duration_s, digits)
    rows = [("duration", f"{duration} s, {plan.scheme}, {plan.intervals} intervals")]
    if plan.objective is not None:
        value = f"{figure(plan.objective, digits)}{objective_unit(problem)}"
        rows.append((f"objective ({problem.objective.name})", value))
    rows += _left_free(plan)
    peaks = zip(problem.mechanism.actuators, plan.certificate.peak_effort, effort_bounds(problem), strict=True)
    return rows + [
        (f"effort {a.name}", f"at most {figure(peak, 5)} {a.unit}, {limits_text(low, high, a.unit, 'limit ')}")
        for a, peak, (low, high) in peaks
    ]


def _left_free(plan: Plan) -> list[tuple[str, str]]:
    """Return the row of a least time on its peak speed and its largest pin force, where no limits on them are set."""
    problem, motion = plan.problem, plan.require_motion("describe")
    if not problem.objective.has("time"):
        return []
    keys, said = {limit.key for limit in limits_of(problem)}, []
    if not affine_limits(problem, of_speed=True) and not any(one.no_load_speed for one in all_effort_bounds(problem)):
        speeds = np.abs(motion.velocity_at(motion.dense_times(8))).max(axis=0)
        joints = problem.mechanism.independent_joints
        joint, speed = max(zip(joints, speeds, strict=True), key=lambda one: (one[0].kind == "hinge", one[1]))
        said.append(f"{joint.name} moves at up to {joint.shown(speed):.4g} {joint.unit}/s, no speed limit is set")
    if not keys & {"closure_force", "pin_force"}:
        forces: Mapping[str, np.ndarray] = {}
        with contextlib.suppress(AssemblyError):  # the loops are open
            forces = samples_of(problem, motion).joint_forces.force
        name = max(forces, key=lambda one: float(forces[one].max()), default="")
        said += [f"pin {name} carries up to {forces[name].max():.4g} N, no limit on pin forces is set"] if name else []
    return [("left free", "; ".join(said))] if said else []


def solves(plan: Plan) -> Table:
    """Return the table of the solves before a plan."""
    digits = min(objective_digits(plan), 6)

    def cell(step: Step, field: str) -> Any:
        value = getattr(step, field)
        return NumberText.of(figure(value, digits), value) if field == "objective" and value is not None else value

    rows = [[cell(step, field) for field in _STEP_HEADS] for step in plan.history]
    return table_of("Attempts in their order, each with its mesh", [*_STEP_HEADS.values()], rows, digits=3)


def least_margin(plan: Plan) -> tuple[str, str]:
    """Return the margin that is the smallest share of its limit, except efforts, with its place and instant."""
    others = (
        (one.share, f"{one.left_shown:.4g} {one.unit}".rstrip() + f" to {one.bound}", f", at {one.time_s:.4g} s")
        for one in plan.certificate.margins
        if not one.of.facts.of_planned_effort
    )
    share, words, at = min(others, default=(None, "no other limit", ""))
    return "least margin besides efforts", words + ("" if share is None else f" ({100 * share:.3g} %)") + at


def proof_blocks(proof: Proof | None, names: Iterable[str] = ()) -> list[Block]:
    """Return a proof's verdict and its findings by answer, in brief grouped by these names; nothing without a proof."""
    if proof is None:
        return []
    blocks: list[Block] = [Text(text=f"proof: {proof.sentence()}", tone="good" if proof.complete else "plain")]
    blocks += [_table(title, proof.of(answer), names) for answer, title in _TITLES.items() if proof.of(answer)]
    sampled = [[finding.name, finding.reason] for finding in proof.of("sampled")]
    return [*blocks, *([table_of("Sampled, not proved", ["claim", "reason"], sampled)] if sampled else [])]


def _table(title: str, findings: Sequence[Finding], names: Iterable[str]) -> Table:
    heads = ["claim", "worst value", "at most or at least", "margin", "unit", "boxes", "time [s]"]
    rows = [
        [
            f.name,
            _digits(f.bound),
            _digits(f.mark),
            None if f.margin is None else NumberText.of(f"{f.margin:.3g}", f.margin),
            f.unit,
            f.boxes,
            f.time_s,
        ]
        for f in findings
    ]
    if any(finding.reason for finding in findings):
        heads, rows = [*heads, "reason"], [[*row, f.reason] for row, f in zip(rows, findings, strict=True)]
    margins = [-np.inf if f.margin is None else f.margin / (abs(f.mark or 0.0) or 1.0) for f in findings]
    return table_of(title, heads, rows, brief=brief_rows(rows, margins, [f.unit for f in findings], names))


def _digits(value: float | None) -> str | None:
    """Return a number with nine digits; zero for the smallest numbers, which balls produce by rounding up."""
    return None if value is None else NumberText.of("0" if abs(value) < np.finfo(float).tiny else f"{value:.9g}", value)
