"""Whole reports: of a plan, and of what other studies find."""

from linkplan.planner.files.plan_folder import versions
from linkplan.planner.plan import Plan
from linkplan.studies.report.document import Report
from linkplan.studies.report.plan_sections import plan_sections


def plan_report(plan: Plan) -> Report:
    """Return the report of a plan."""
    return Report(
        title=f"Plan {plan.problem.name}",
        verdict=plan.message[:1].upper() + plan.message[1:],
        passed=plan.status == "optimal",
        versions=versions(),
        sections=plan_sections(plan),
    )
