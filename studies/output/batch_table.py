"""A batch of plans as a table: what was asked, what came of it."""

from collections.abc import Sequence

from linkplan.planner.files.batch_file import Case
from linkplan.planner.files.plan_folder import record
from linkplan.planner.plan import Plan
from linkplan.studies.output.tables import table


def batch_record(results: Sequence[tuple[Case, Plan]]) -> dict:
    """Return a batch's results by case."""
    return {"cases": {case.name: {"settings": list(case.settings), **record(plan)} for case, plan in results}}


def batch_text(results: Sequence[tuple[Case, Plan]]) -> str:
    """Return a batch's results as a table, and a line for each case without a plan."""
    rows = []
    for case, plan in results:
        duration = None if plan.trajectory is None else plan.trajectory.duration_s
        peak = None if plan.certificate is None else float(plan.certificate.peak_effort.max())
        seconds = sum(step.build_s + step.solve_s for step in plan.history)
        warm = "again" if plan.solved_again else "anew"
        rows.append([case.name, " ".join(case.settings), plan.status, plan.objective, duration, peak, seconds, warm])
    head = ["case", "set", "status", "objective", "duration [s]", "peak effort", "solver [s]", "solved"]
    lines = [table(head, rows)]
    lines += [f"{case.name}: {plan.message}" for case, plan in results if plan.status != "optimal"]
    return "\n".join(lines)
