"""The section of a robust plan: the effort reserve for feedback, the corners of the model's ranges, and their price."""

import math

import numpy as np

from linkplan.planner.limits.samples import Samples
from linkplan.planner.plan.plan import Plan
from linkplan.planner.search.planning import saved_price
from linkplan.studies.output.document import Block, Facts, Plot, Section, Table, Text
from linkplan.studies.output.lines import TIME, Line, plots


def robust_section(plan: Plan, motion: Samples, group: str, period: float | None) -> Section | None:
    """Return the section of a plan's reserve and corners; None if it has neither."""
    corners, reserve = plan.problem.robust.corners, plan.problem.limits.reserve
    if not corners and not reserve:
        return None
    price = saved_price(plan)
    said = "unknown, because the plan was saved without it" if price is None else price.sentence()
    blocks: list[Block] = [Facts(rows=_facts(plan)), Text(text=f"{said[:1].upper()}{said[1:]}.")]
    if corners:
        blocks += [_table(plan), *_efforts(plan, motion, group, period)]
    return Section(title="Reserve and corners", blocks=blocks, depth=2)


def _facts(plan: Plan) -> list[tuple[str, str]]:
    problem, robust = plan.problem, plan.problem.robust
    joints = {joint.name: joint for joint in problem.mechanism.joints}
    rows = []
    if problem.limits.reserve:
        rows.append(("left to feedback", f"{100 * problem.limits.reserve:.3g} % of every effort range"))
        for actuator, (low, high), (least, most) in zip(
            problem.mechanism.actuators, problem.limits.effort, problem.limits.actuators_effort, strict=True
        ):
            said = f"{low:.5g} to {high:.5g} {actuator.unit}, of {least:.5g} to {most:.5g}"
            rows.append((f"limits of the plan for {actuator.name}", said))
    for name, (low, high) in (("payload", robust.payload_factor), ("torque constant", robust.torque_constant_factor)):
        if low != high or low != 1:
            rows.append((f"factor on the {name}", f"{low:g} to {high:g}"))
    friction = (
        ("viscous friction", robust.viscous_friction, ("N.m.s/rad", "N.s/m")),
        ("dry friction", robust.coulomb_friction, ("N.m", "N")),
    )
    for name, ranges, (turning, sliding) in friction:
        for joint, (low, high) in ranges.items():
            unit = turning if joints[joint].kind == "hinge" else sliding
            rows.append((f"{name} at {joint}", f"{low:g} to {high:g} {unit}"))
    return rows


def _table(plan: Plan) -> Table:
    """Return the table of corners, each with its effort nearest to a limit, from the certificate."""
    problem, n_u = plan.problem, plan.problem.mechanism.n_u
    rows = []
    for item, corner in enumerate(problem.robust.corners):
        of_it = [one for one in plan.certificate.margins if one.what == "robust" and one.item // n_u == item]
        for worst in sorted(of_it, key=lambda one: one.left)[:1]:
            actuator = problem.mechanism.actuators[worst.item % n_u]
            places = 4 - math.floor(math.log10(abs(worst.limit) or 1.0))  # five digits of the limit
            figures = [round(x, places) + 0.0 for x in (worst.value, worst.limit, worst.left)]
            at = float(f"{worst.time_s:.5g}")
            rows.append([corner.description, worst.kept, actuator.name, *figures, actuator.unit, at])
    heads = [(head, "") for head in ("machine", "passed", "nearest to its limit", "effort", "limit", "left", "unit")]
    return Table(title="Corners of the ranges, each certified between the nodes", columns=[*heads, ("at", "s")], rows=rows)


def _efforts(plan: Plan, motion: Samples, group: str, period: float | None) -> list[Plot]:
    """Return the plots of the effort of each actuator, for every corner and the nominal model."""
    problem, mechanism = plan.problem, plan.problem.mechanism
    corners = problem.robust.corners
    found = []
    for j, actuator in enumerate(mechanism.actuators):
        bounds = tuple(problem.limits.effort[j])
        needed, unit = motion.u[:, j], actuator.unit
        nominal = Line(name="nominal", values=needed, unit=unit, limits=bounds, colour=None, width=2.4)
        lines = [
            Line(name=corner.description, values=np.asarray(motion.corner_efforts[:, item, j]), unit=unit, limits=bounds)
            for item, corner in enumerate(corners)
        ]
        title = f"Effort of {actuator.name} that each machine needs for the motion"
        found += plots(title, "effort", TIME, motion.time, [*lines, nominal], group=group, period=period)
    return found
