"""The facts beside the animation of a plan: peak effort and its limit, the least other margin, duration, objective."""

from collections.abc import Iterator

import numpy as np

from linkplan.planner.plan import Plan
from linkplan.studies.output.document import Facts
from linkplan.studies.output.draw_plan import Motion
from linkplan.studies.output.plan_blocks import figure, joint_margins, known_digits, objective_unit


def verdict_sentence(plan: Plan) -> str:
    """Return the verdict of a plan in one sentence."""
    if plan.certificate is None or not plan.passed:
        return plan.message
    return f"{plan.message}; every limit is kept at and between the nodes"


def lead_facts(plan: Plan, motion: Motion) -> Facts:
    """Return the facts of a plan with a motion that its reader looks for first."""
    problem, digits = plan.problem, known_digits(plan)
    rows = [_peak_effort(plan, motion), _least_margin(plan)]
    rows.append(("duration", f"{figure(plan.trajectory.duration_s, digits)} s"))
    if plan.objective is not None:
        value = f"{figure(plan.objective, digits)}{objective_unit(problem)}"
        rows.append(("objective", f"{problem.objective.name}: {value}"))
    return Facts(rows=[row for row in rows if row is not None])


def _peak_effort(plan: Plan, motion: Motion) -> tuple[str, str] | None:
    """Return the largest effort as a share of its limit, with its instant; without limits, the largest effort."""
    actuators = plan.problem.mechanism.actuators
    if not actuators:
        return None
    limits = np.asarray(plan.problem.limits.effort, dtype=float)
    side = np.where(motion.effort < 0, -limits[:, 0], limits[:, 1])
    share = np.abs(motion.effort) / np.where(np.isfinite(side) & (side > 0), side, np.inf)
    size = share if share.any() else np.abs(motion.effort)
    at, j = np.unravel_index(int(np.argmax(size)), size.shape)
    actuator, value = actuators[j], motion.effort[at, j]
    limit = limits[j, 0] if value < 0 else limits[j, 1]
    known = f" of {limit:.5g} {actuator.unit} ({100 * share[at, j]:.3g} %)"
    of = known if np.isfinite(limit) else f" {actuator.unit}, no limit"
    return "peak effort", f"{value:.4g}{of}, {actuator.name} at {motion.time_s[at]:.4g} s"


def _least_margin(plan: Plan) -> tuple[str, str]:
    """Return the margin that is least as a share of its limit, efforts apart, with its place and instant."""
    found = sorted(_margins(plan), key=lambda one: one[0])
    if not found:
        return "least margin", "no limit besides those of the efforts"
    share, words = found[0]
    return "least margin, as a share of its limit or range", f"{100 * share:.3g} %: {words}"


def _margins(plan: Plan) -> Iterator[tuple[float, str]]:
    """Yield every margin as a share of its limit and in words."""
    joints, certificate = plan.problem.mechanism.joints, plan.certificate
    for title, per, k, (low, high), margin in joint_margins(plan):
        whole = high - low if np.isfinite(high - low) else max(abs(x) for x in (low, high) if np.isfinite(x))
        when = certificate.worst_time_s.get(title)
        at = "" if when is None else f", at {when:.4g} s"
        yield margin / (whole or 1.0), f"{joints[k].shown(margin):.4g} {joints[k].unit}{per} to the {title}{at}"
    for one in certificate.margins:
        words = f"{one.left:.4g} {one.unit}".rstrip() + f" to the limit on {one.title}, at {one.time_s:.4g} s"
        yield one.left / (abs(one.limit) or abs(one.value) or 1.0), words
