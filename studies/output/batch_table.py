"""A batch of plans as a table: what was asked, what came of it."""

from collections.abc import Sequence

from linkplan.planner.files.batch_file import Case
from linkplan.planner.files.plan_folder import record
from linkplan.planner.plan import Plan
from linkplan.studies.output.tables import table


def case_record(case: Case, plan: Plan) -> dict:
    """Return a case's result as `batch.json` has it."""
    return {"settings": list(case.settings), **record(plan)}


def case_row(case: Case, plan: Plan) -> list:
    """Return a case's row of the table."""
    duration = None if plan.trajectory is None else plan.trajectory.duration_s
    peak = None if plan.certificate is None else float(plan.certificate.peak_effort.max())
    seconds = sum(step.build_s + step.solve_s for step in plan.history)
    warm = "again" if plan.solved_again else "anew"
    return [case.name, " ".join(case.settings), plan.status, plan.objective, duration, peak, seconds, warm]


def batch_text(rows: Sequence[list], failures: Sequence[str]) -> str:
    """Return a batch's rows as a table, and a line for each case without a plan."""
    head = ["case", "set", "status", "objective", "duration [s]", "peak effort", "solver [s]", "solved"]
    lines = [table(head, rows)]
    lines += failures
    return "\n".join(lines)
