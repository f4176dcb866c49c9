"""A batch of plans as a table: the settings and the result of every case."""

from collections.abc import Sequence

from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.keys.sections import CaseSection
from linkplan.studies.output.document import Block, Report, Section, Text, table_of
from linkplan.studies.output.plan_blocks import figure, objective_digits, objective_unit
from linkplan.studies.output.report_file import report_of


def case_row(case: CaseSection, plan: Plan) -> list:
    """Return a case's row of the table."""
    problem, digits = plan.problem, objective_digits(plan)
    duration = None if plan.duration_s is None else figure(plan.duration_s, digits)
    objective = None if plan.objective is None else f"{figure(plan.objective, min(digits, 6))}{objective_unit(problem)}"
    peaks = () if plan.certificate is None else zip(plan.certificate.peak_effort, problem.mechanism.actuators, strict=True)
    peak = max(((float(effort), actuator.unit) for effort, actuator in peaks), default=None)
    seconds = f"{sum(step.build_s + step.solve_s for step in plan.history):.2g}"
    shown = None if peak is None else f"{peak[0]:.4g} {peak[1]}"
    warm = "again" if plan.solved_again else "anew"
    return [case.name, " ".join(case.set), plan.status, objective, duration, shown, seconds, warm]


def batch_report(rows: Sequence[list], failures: Sequence[str]) -> Report:
    """Return the report of a batch: the number of cases with a plan, and the blocks of all cases."""
    sections = [Section(title="Cases", blocks=batch_blocks(rows, failures))]
    return report_of("Batch", f"{len(rows) - len(failures)} of {len(rows)} cases planned", not failures, sections)


def batch_blocks(rows: Sequence[list], failures: Sequence[str]) -> list[Block]:
    """Return a batch's rows as a table, and a line for each case without a plan."""
    heads = ["case", "set", "status", "objective", "duration [s]", "peak effort", "solver [s]", "solved"]
    return [table_of("", heads, rows), *(Text(text=failure) for failure in failures)]
