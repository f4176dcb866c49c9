"""The report of a folder that linkplan wrote: its saved document, or a report made from its plan or record."""

import functools
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from linkplan.models.errors import PlanFileError
from linkplan.planner.files.folders import complete
from linkplan.planner.files.manifest import RECORDS, read_record
from linkplan.planner.plan.folder import read_plan, unchecked
from linkplan.planner.plan.plan import Plan
from linkplan.planner.plan.record import read_plan_record
from linkplan.planner.proof.finding import OWN_MOTION
from linkplan.studies.output.document import Block, Facts, Report, Section, Table, Text
from linkplan.studies.output.plan_sections import plan_report
from linkplan.studies.output.report_file import DOCUMENT, read_document, report_of
from linkplan.studies.variations.experiment.experiment_sections import experiment_report
from linkplan.studies.variations.experiment.study import RECORD as EXPERIMENT
from linkplan.studies.variations.experiment.study import saved_outcome


def folder_report(folder: Path, again: Callable[[Path, str, int], str] | None = None) -> Report:
    """Return the report of a saved folder: of a plan, a check, a comparison, an experiment, a feedback loop, gains, a batch.

    Args:
        folder: saved by linkplan.
        again: returns the command that runs a tracker's sample of an experiment's folder again, if there is one.

    Raises:
        PlanFileError: if the folder is not a result, or is damaged.
    """
    if not folder.is_dir():
        raise PlanFileError(f"'{folder}' is not a folder; a report needs a folder that linkplan wrote")
    complete(folder)
    if (folder / DOCUMENT).is_file():
        return read_document(folder / DOCUMENT)
    if (folder / "plan.json").is_file():
        return plan_report(saved_plan(folder))
    if (folder / EXPERIMENT).is_file():
        return experiment_report(saved_outcome(folder), None if again is None else functools.partial(again, folder))
    record = next((name for name in RECORDS if (folder / name).is_file()), None)
    if record is None:
        raise PlanFileError(f"'{folder}' has no result of linkplan, which is one of {', '.join(RECORDS)}")
    return _record_report(folder / record)


def saved_plan(folder: Path) -> Plan:
    """Return a saved plan with a new certificate, passed or not, and with the history of its solves.

    Raises:
        PlanFileError: if the folder is damaged, or its model has changed.
    """
    plan, note = read_plan(folder, anyway=True), unchecked(folder)
    proof = read_plan_record(folder).proof
    if proof is not None:  # a record is not trusted
        plan = plan.with_proof(existence=OWN_MOTION in str(proof.get("proved")))
    return plan if note is None else replace(plan, problem=replace(plan.problem, notes=(*plan.problem.notes, note)))


def _record_report(path: Path) -> Report:
    """Return the report of a record without a document: from an earlier version."""
    said = read_record(path, dict[str, Any])
    lacks = Text(
        text=f"This folder has no {DOCUMENT}, so the report shows the numbers of {path.name}. Run the command again for"
        " animation and curves.",
        tone="note",
    )
    name = str(said.get("mechanism") or said.get("model") or path.parent.name)
    blocks = [lacks, *_blocks(said)]
    message = said.get("message")
    verdict = message if isinstance(message, str) else f"figures of {path.name}"
    sections = [Section(title=f"{path.stem} of {name}", blocks=blocks)]
    return report_of(f"{path.stem[:1].upper()}{path.stem[1:]} of {name}", verdict, None, sections)


def _blocks(said: Mapping) -> list[Block]:
    """Return a record as blocks: single values as facts, lists of records as tables."""
    facts, tables = [], []
    for key, value in said.items():
        if isinstance(value, dict) and value and all(isinstance(row, dict) for row in value.values()):
            value = [{"name": name, **row} for name, row in value.items()]
        if isinstance(value, list) and value and all(isinstance(row, dict) for row in value):
            tables.append(_table(str(key), value))
        elif isinstance(value, dict):
            facts += [(f"{key}, {name}", _text(item)) for name, item in value.items() if _is_plain(item)]
        elif _is_plain(value):
            facts.append((str(key), _text(value)))
    return [Facts(rows=facts), *tables]


def _table(title: str, rows: list[dict]) -> Table:
    heads = list(dict.fromkeys(name for row in rows for name, value in row.items() if _is_plain(value)))
    cells = [[row.get(head) if _is_cell(row.get(head)) else _text(row.get(head)) for head in heads] for row in rows[:500]]
    return Table(title=title, columns=[(str(head), "") for head in heads], rows=cells)


def _is_cell(value: object) -> bool:
    return value is None or isinstance(value, bool | int | float | str)


def _is_plain(value: object) -> bool:
    return _is_cell(value) or (isinstance(value, list) and all(_is_cell(item) for item in value))


def _text(value: object) -> str:
    if isinstance(value, list):
        text = ", ".join(_text(item) for item in value)
    elif isinstance(value, float):
        text = f"{value:.6g}"
    else:
        text = "none" if value is None else str(value)
    longest = 300
    return text if len(text) <= longest else f"{text[:longest]} ..."
