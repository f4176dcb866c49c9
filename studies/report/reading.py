"""The report of a folder that linkplan wrote: its saved document, or a report made from its plan or experiment."""

import functools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from msgspec import structs

from linkplan.models.errors import PlanFileError
from linkplan.planner.files.folders import restore
from linkplan.planner.plan.folder import read_plan, unchecked
from linkplan.planner.plan.plan import Plan
from linkplan.planner.plan.record import read_plan_record
from linkplan.planner.proof.finding import OWN_MOTION
from linkplan.studies.output.document import Report
from linkplan.studies.output.plan_sections import plan_report
from linkplan.studies.output.report_file import DOCUMENT, read_document
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
    restore(folder)
    if not folder.is_dir():
        raise PlanFileError(f"'{folder}' is not a folder; a report needs a folder that linkplan wrote")
    if (folder / DOCUMENT).is_file():
        return read_document(folder / DOCUMENT)
    if (folder / "plan.json").is_file():
        return plan_report(saved_plan(folder))
    if (folder / EXPERIMENT).is_file():
        outcome = saved_outcome(folder)
        return structs.replace(outcome, again=again and functools.partial(again, folder)).document()
    raise PlanFileError(
        f"'{folder}' has no {DOCUMENT} of a linkplan result; version 1.0 did not write this file: run the command again"
    )


def saved_plan(folder: Path) -> Plan:
    """Return a saved plan with a new certificate, passed or not, and with the history of its solves.

    Raises:
        PlanFileError: if the folder is damaged, or its model has changed.
    """
    plan, note = read_plan(folder, anyway=True), unchecked(folder)
    proof = read_plan_record(folder).proof
    if proof is not None:  # the saved certificate is not trusted
        plan = plan.with_proof(existence=OWN_MOTION in str(proof.get("proved")))
    return plan if note is None else replace(plan, problem=replace(plan.problem, remarks=(*plan.problem.remarks, note)))
