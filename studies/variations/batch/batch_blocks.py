"""The result of a batch, whose fields are the record `batch.json`: the settings and the plan of every case."""

from typing import Any

from msgspec import Struct

from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.keys.sections import CaseSection
from linkplan.studies.output.document import Block, Report, Section, Text, table_of
from linkplan.studies.output.plan_blocks import figure, objective_digits, objective_unit
from linkplan.studies.output.report_file import report_of
from linkplan.studies.output.result import Result


class BatchOutcome(Result, Struct, frozen=True, kw_only=True, eq=False):
    """The results of a batch: the record of each case, rows of the table, a sentence for each case without a plan."""

    cases: dict[str, dict[str, Any]]
    rows: Beside[list[list]] = NOT_READ
    failures: Beside[tuple[str, ...]] = NOT_READ

    @property
    def passed(self) -> bool:
        """Whether every case has a certified plan."""
        return not self.failures

    def blocks(self) -> list[Block]:
        """Return the table of the cases, and a line for each case without a plan."""
        heads = ["case", "set", "status", "objective", "duration [s]", "peak effort", "solver [s]", "start"]
        return [table_of("", heads, self.rows), *(Text(text=failure) for failure in self.failures)]

    def document(self) -> Report:
        """Return the report: the number of cases with a plan, and the blocks of all cases."""
        n, lost = len(self.rows), len(self.failures)
        sections = [Section(title="Cases", blocks=self.blocks())]
        return report_of("Batch", f"{n - lost} of {n} cases planned", self.passed, sections)

    def __repr__(self) -> str:
        return f"BatchOutcome({len(self.rows)} cases, {len(self.failures)} without a plan)"


def case_row(case: CaseSection, plan: Plan) -> list:
    """Return a case's row of the table."""
    problem, digits = plan.problem, objective_digits(plan)
    duration = None if plan.duration_s is None else figure(plan.duration_s, digits)
    objective = None if plan.objective is None else f"{figure(plan.objective, min(digits, 6))}{objective_unit(problem)}"
    peaks = () if plan.certificate is None else zip(plan.certificate.peak_effort, problem.mechanism.actuators, strict=True)
    peak = max(((float(effort), actuator.unit) for effort, actuator in peaks), default=None)
    seconds = f"{sum(step.build_s + step.solve_s for step in plan.history):.2g}"
    shown = None if peak is None else f"{peak[0]:.4g} {peak[1]}"
    warm = "a solved case" if plan.solved_again else "its own"
    return [case.name, " ".join(case.set), plan.status, objective, duration, shown, seconds, warm]
