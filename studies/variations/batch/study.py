"""A complete batch: an engine plans its blocks, each block's results are stored, and the end result is a folder of plans."""

import functools
import tempfile
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
from msgspec import Struct, field
from msgspec.structs import replace

from linkplan.models.errors import PlanFileError, one_line
from linkplan.models.work_folders import replace_file
from linkplan.planner.files.columns import read_trajectory
from linkplan.planner.files.folders import check_target, plain_record, write_json
from linkplan.planner.files.tables import PHASES_FILE, PLAN_FILE, PLAN_FILES
from linkplan.planner.plan.folder import record_of, versions, write_plan
from linkplan.planner.plan.phased import PhasedRecord
from linkplan.planner.plan.plan import Plan
from linkplan.planner.plan.record import read_plan_record
from linkplan.planner.problem.keys.sections import BatchFile, CaseSection
from linkplan.planner.refinement.history import silent
from linkplan.planner.search.batch import check_batch, plan_cases
from linkplan.studies.output.report_file import save_report
from linkplan.studies.variations.batch.batch_blocks import BatchOutcome, CasePlans, CaseRow, case_row
from linkplan.studies.variations.tasks.engine import Engine, Say, serial
from linkplan.studies.variations.tasks.streaming import blocks_of, complete
from linkplan.studies.variations.tasks.unfinished import finish, part, parts_folder, working

# A block is a sixteenth of the cases, within these bounds. Short blocks use more workers and are quickly repeated after an
# interruption; long blocks reuse more solutions.
_MIN_BLOCK_CASES, _MAX_BLOCK_CASES = 8, 64


class Planned(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One case's answer: its row of the table, its record, the reason if there is no plan, and the plan's files by name."""

    name: str
    row: CaseRow
    record: dict[str, Any]
    failure: str | None
    files: dict[str, bytes] = field(default_factory=dict)


def case_blocks(n: int) -> list[range]:
    """Return the cases of each block of a batch of n."""
    return blocks_of(n, min(_MAX_BLOCK_CASES, max(_MIN_BLOCK_CASES, -(-n // 16))))


def plan_block(batch: BatchFile, block: int, target: Path, parquet: bool, say: Say) -> list[Planned]:
    """Return the answers of a block's cases.

    Args:
        batch: the batch.
        block: index of the block.
        target: the final folder of the plans.
        parquet: write a trajectory.parquet for every plan.
        say: receives the name of each case.
    """
    part, found = case_blocks(len(batch.case))[block], []
    cases = [batch.case[i] for i in part]
    for case, plan in plan_cases(batch, cases, lambda name: say(f"{part[len(found)] + 1} of {len(batch.case)}: {name}")):
        files = {}
        if plan.passed:
            with tempfile.TemporaryDirectory(prefix="linkplan-") as place:
                _write(plan, Path(place), target / case.name, parquet)
                written = sorted(path for path in Path(place).rglob("*") if path.is_file())
                files = {path.relative_to(place).as_posix(): path.read_bytes() for path in written}
        failure = None if plan.passed else f"{case.name}: {plan.message}"
        record = record_of(plan) if isinstance(plan, Plan) else plan
        said = {"settings": list(case.set), **plain_record(record)}
        answer = Planned(name=case.name, row=case_row(case, plan), record=said, failure=failure, files=files)
        found.append(answer)
    return found


def _write(plan: Plan | PhasedRecord, place: Path, target: Path, parquet: bool) -> None:
    """Write a plan, or a plan in phases with a folder for each, into an empty folder, which is moved to `target`."""
    if isinstance(plan, Plan):
        write_plan(plan, place, target, parquet=parquet)
        return
    write_json(place / PHASES_FILE, plan)
    for name, phase in zip(plan.folders, plan.plans, strict=True):
        (place / name).mkdir()
        write_plan(phase, place / name, target / name, parquet=parquet)


def packed(answers: list[Planned]) -> bytes:
    """Return the answers of a block as the content of one file."""
    return msgspec.msgpack.encode(answers)


def unpacked(path: Path, cases: Sequence[CaseSection], place: Path) -> list[Planned]:
    """Return the answers of a block from its file, and write the plans into folders at `place`.

    Raises:
        PlanFileError: if the file is damaged, belongs to other cases, or holds an invalid plan.
    """
    if not path.is_file():
        raise PlanFileError(f"'{path}' is not a file; remove it and run the same command again to plan its cases")
    try:
        answers = msgspec.msgpack.decode(path.read_bytes(), type=list[Planned])
        if [one.name for one in answers] != [case.name for case in cases]:
            raise ValueError("its cases are not those of the batch")
        for answer in answers:
            if others := sorted(name for name in answer.files if not _is_file_of_plan(name)):
                raise ValueError(f"'{answer.name}/{others[0][:100]}' is not a file of its plans")
            folder = place / answer.name
            for name, content in answer.files.items():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_bytes(content)
            for plan in [] if answer.failure else [path.parent for path in folder.rglob(PLAN_FILE)] or [folder]:
                read_plan_record(plan)
                read_trajectory(plan / "trajectory.npz")
    except (msgspec.MsgspecError, ValueError, PlanFileError) as error:
        why = one_line(error)
        raise PlanFileError(
            f"'{path}' is damaged: {why}; remove it and run the same command again to plan its cases"
        ) from error
    return answers


def _is_file_of_plan(name: str) -> bool:
    """Return whether a file is one of a plan's folder, or of a phase's folder in it."""
    *folders, last = name.split("/")
    return len(folders) < 2 and ".." not in folders and last in (*PLAN_FILES, *([] if folders else [PHASES_FILE]))


RECORD = "batch.json"


def run_batch(
    batch: BatchFile,
    target: Path | None,
    say: Say,
    *,
    engine: Engine = serial,
    parquet: bool = False,
) -> BatchOutcome:
    """Return the outcome of a batch, and write its plans into a folder.

    Args:
        batch: the problem and its cases.
        target: the folder, written in one step at the end; until then the parts are kept next to it. Without one it is a
            temporary folder, which lasts as long as the outcome.
        say: receives progress messages.
        engine: runs the blocks.
        parquet: write a trajectory.parquet for every plan.

    Raises:
        LinkplanError: for an invalid case, before any case is planned.
        PlanFileError: if the folder holds something else, or cannot be written.
    """
    temporary = TemporaryDirectory(prefix="linkplan-") if target is None else None
    target = target or Path(temporary.name) / "batch"
    asked = _asked(batch, target, parquet)
    check_target(target, RECORD)
    outcomes = []
    work = functools.partial(_work, batch, target, parquet, say if engine is serial else None)
    with parts_folder(target) as folder, working(folder, asked, "a batch"):

        def write(block: int, answers: list[Planned]) -> None:
            replace_file(part(folder, block, "msgpack"), functools.partial(Path.write_bytes, data=packed(answers)))

        def save(place: Path) -> None:
            outcomes.append(_outcome(folder, batch, place))
            write_json(place / RECORD, outcomes[0])
            save_report(outcomes[0].document(), place, page=False)

        complete(folder, case_blocks(len(batch.case)), "cases", engine, work, write, say)
        finish(folder, target, save, RECORD)
    return replace(outcomes[0], plans=CasePlans(target, outcomes[0].cases, temporary))


def _asked(batch: BatchFile, target: Path, parquet: bool) -> dict:
    """Return all inputs of a batch's files."""
    cases = {case.name: list(case.set) for case in batch.case}
    return {
        "problem": batch.problem,
        "set": list(batch.set),
        "cases": cases,
        "meaning": check_batch(batch),
        "place": str(target.resolve()),
        "parquet": parquet,
        "versions": versions(),
    }


def _work(batch: BatchFile, target: Path, parquet: bool, say: Say | None, block: int, threads: int) -> list[Planned]:
    """Return a block's answers; runs in any worker process, with one thread."""
    del threads
    return plan_block(batch, block, target, parquet, say or silent)


def _outcome(folder: Path, batch: BatchFile, place: Path) -> BatchOutcome:
    rows, failures, cases = [], [], {}
    for block, numbers in enumerate(case_blocks(len(batch.case))):
        cases_here = [batch.case[i] for i in numbers]
        for answer in unpacked(part(folder, block, "msgpack"), cases_here, place):
            rows.append(answer.row)
            failures += [] if answer.failure is None else [answer.failure]
            cases[answer.name] = answer.record
    return BatchOutcome(rows=rows, failures=tuple(failures), cases=cases)
