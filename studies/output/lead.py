"""The facts shown beside the animation of a plan: peak effort and its limit, least other margin, duration, objective."""

import numpy as np

from linkplan.planner.limits.kinds import effort_bounds
from linkplan.planner.limits.samples import Samples
from linkplan.planner.plan.plan import Plan
from linkplan.studies.output.document import Facts
from linkplan.studies.output.plan_blocks import figure, least_margin, objective_digits, objective_unit


def verdict_sentence(plan: Plan) -> str:
    """Return the verdict of a plan in one sentence."""
    if plan.certificate is None or not plan.passed:
        return plan.message
    return f"{plan.message}; every limit is satisfied at the nodes and between them"


def lead_facts(plan: Plan, motion: Samples) -> Facts:
    """Return the main facts of a plan with a motion."""
    problem, digits = plan.problem, objective_digits(plan)
    rows = [_peak_effort(plan, motion), least_margin(plan)]
    rows.append(("duration", f"{figure(plan.trajectory.duration_s, digits)} s"))
    if plan.objective is not None:
        value = f"{figure(plan.objective, digits)}{objective_unit(problem)}"
        rows.append(("objective", f"{problem.objective.name}: {value}"))
    return Facts(rows=[row for row in rows if row is not None])


def _peak_effort(plan: Plan, motion: Samples) -> tuple[str, str] | None:
    """Return the largest effort as a share of its limit, with its instant; without limits, the largest effort."""
    actuators = plan.problem.mechanism.actuators
    if not actuators:
        return None
    limits = effort_bounds(plan.problem)
    side = np.where(motion.u < 0, -limits[:, 0], limits[:, 1])
    share = np.abs(motion.u) / np.where(np.isfinite(side) & (side > 0), side, np.inf)
    size = share if share.any() else np.abs(motion.u)
    at, j = np.unravel_index(int(np.argmax(size)), size.shape)
    actuator, value = actuators[j], motion.u[at, j]
    limit = limits[j, 0] if value < 0 else limits[j, 1]
    known = f" of {limit:.5g} {actuator.unit} ({100 * share[at, j]:.3g} %)"
    of = known if np.isfinite(limit) else f" {actuator.unit}, no limit"
    return "peak effort", f"{value:.4g}{of}, {actuator.name} at {motion.time[at]:.4g} s"
