"""The result of a batch, whose fields are the record `batch.json`: the settings and the plan of every case."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, overload

import msgspec
from msgspec import Struct

from linkplan.planner.files.structs import NOT_READ, Beside, read_value
from linkplan.planner.files.tables import parse_value
from linkplan.planner.plan.folder import plan_without_motion, read_plan
from linkplan.planner.plan.phased import PhasedRecord
from linkplan.planner.plan.plan import Plan
from linkplan.planner.plan.record import PlanRecord
from linkplan.planner.problem.keys.sections import CaseSection
from linkplan.studies.output.document import Block, Report, Section, Text, table_of
from linkplan.studies.output.numbers import significant
from linkplan.studies.output.phased_plan import PhasedPlan
from linkplan.studies.output.plan_blocks import objective_digits, objective_unit
from linkplan.studies.output.report_file import report_of
from linkplan.studies.output.result import Result


class CaseRow(Struct, frozen=True, kw_only=True):
    """A case's row of the table: its settings by key, and the figures of its plan, rounded to the digits that are known."""

    name: str
    settings: dict[str, bool | int | float | str]
    status: str
    objective: float | None
    objective_unit: str
    duration_s: float | None
    peak_effort: dict[str, float]
    """The largest effort of all actuators of a unit, by unit."""
    solver_s: float
    start: str


@dataclasses.dataclass(frozen=True, eq=False, slots=True)
class CasePlans(Sequence[Plan | PhasedPlan]):
    """The plans of a batch in the order of its cases, each read and certified again when it is asked for.

    A case without a certified motion has a plan with its verdict only. `temporary` is the folder's owner, if it is deleted
    together with this object.
    """

    folder: Path
    cases: Mapping[str, Mapping[str, Any]]
    temporary: TemporaryDirectory | None = None

    def __len__(self) -> int:
        return len(self.cases)

    @overload
    def __getitem__(self, index: int) -> Plan | PhasedPlan: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Plan | PhasedPlan]: ...
    def __getitem__(self, index: int | slice) -> Plan | PhasedPlan | Sequence[Plan | PhasedPlan]:
        name = list(self.cases)[index]
        if isinstance(name, list):
            return dataclasses.replace(self, cases={one: self.cases[one] for one in name})
        if "junctions" in self.cases[name]:
            record = {key: value for key, value in self.cases[name].items() if key != "settings"}
            saved = msgspec.convert(record, PhasedPlan, dec_hook=read_value)
            return PhasedPlan.read(self.folder / name) if saved.passed else saved
        saved = msgspec.convert(self.cases[name], PlanRecord, dec_hook=read_value)
        if saved.status in ("optimal", "feasible"):
            return read_plan(self.folder / name, anyway=True)
        return plan_without_motion(self.folder / name, saved)

    def __repr__(self) -> str:
        return f"CasePlans({len(self)} plans in '{self.folder}')"


class BatchOutcome(Result, Struct, frozen=True, kw_only=True, eq=False):
    """The results of a batch: the record of each case, its plan, its row, a sentence for each case without a plan."""

    cases: dict[str, dict[str, Any]]
    plans: Beside[Sequence[Plan | PhasedPlan]] = NOT_READ
    """The plans in the order of the cases. Each is read when it is asked for, so that a large batch takes little memory."""
    rows: Beside[list[CaseRow]] = NOT_READ
    failures: Beside[tuple[str, ...]] = NOT_READ

    @property
    def passed(self) -> bool:
        """Whether every case has a certified plan."""
        return not self.failures

    def blocks(self) -> list[Block]:
        """Return the table of the cases, with a column for each key that varies, and a line for each case without a plan."""
        keys = list(dict.fromkeys(key for row in self.rows for key in row.settings))
        costs = list(dict.fromkeys(row.objective_unit for row in self.rows if row.objective is not None)) or [""]
        units = list(dict.fromkeys(unit for row in self.rows for unit in row.peak_effort))
        heads = ["case", *((key, "") for key in keys), "status", *(("objective", unit) for unit in costs), "duration [s]"]
        heads += [*(("peak effort", unit) for unit in units), "solver [s]", "start"]
        cells = [
            [row.name, *map(row.settings.get, keys), row.status]
            + [row.objective if row.objective_unit == unit else None for unit in costs]
            + [row.duration_s, *map(row.peak_effort.get, units), row.solver_s, row.start]
            for row in self.rows
        ]
        return [table_of("", heads, cells, digits=9), *(Text(text=failure) for failure in self.failures)]

    def document(self) -> Report:
        """Return the report: the number of cases with a plan, and the blocks of all cases."""
        n, lost = len(self.rows), len(self.failures)
        sections = [Section(title="Cases", blocks=self.blocks())]
        return report_of("Batch", f"{n - lost} of {n} cases planned", self.passed, sections)

    def __repr__(self) -> str:
        return f"BatchOutcome({len(self.rows)} cases, {len(self.failures)} without a plan)"


def case_row(case: CaseSection, found: Plan | PhasedRecord) -> CaseRow:
    """Return a case's row of the table."""
    plans, peaks = [found] if isinstance(found, Plan) else list(found.plans), {}
    digits = min((objective_digits(plan) for plan in plans), default=0)
    for plan in plans:
        efforts = () if plan.certificate is None else plan.certificate.peak_effort
        for effort, actuator in zip(efforts, plan.problem.mechanism.actuators, strict=False):
            peaks[actuator.unit] = max(peaks.get(actuator.unit, 0.0), float(effort))
    if isinstance(found, Plan):
        unit, again = objective_unit(found.problem).strip(), found.solved_again
    else:
        unit, again = PhasedPlan.of(found).objective_unit.strip(), False
    settings = {}
    for setting in case.set:
        key, _, text = (part.strip() for part in setting.partition("="))
        value = parse_value(text, setting)
        settings[key] = value if isinstance(value, bool | int | float | str) else text
    return CaseRow(
        name=case.name,
        settings=settings,
        status=found.status,
        objective=significant(found.objective, min(digits, 6)),
        objective_unit=unit,
        duration_s=significant(found.duration_s, digits),
        peak_effort={unit: float(f"{peak:.4g}") for unit, peak in peaks.items()},
        solver_s=float(f"{sum(step.build_s + step.solve_s for plan in plans for step in plan.history):.2g}"),
        start="a solved case" if again else "its own",
    )
