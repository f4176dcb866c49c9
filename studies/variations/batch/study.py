"""A complete batch: an engine plans its blocks, each block's results are stored, and the end result is a folder of plans."""

import functools
from pathlib import Path
from tempfile import TemporaryDirectory

from msgspec.structs import replace

from linkplan.models.work_folders import replace_file
from linkplan.planner.files.folders import check_target, write_json
from linkplan.planner.plan.folder import versions
from linkplan.planner.problem.keys.sections import BatchFile
from linkplan.planner.refinement.history import silent
from linkplan.planner.search.batch import check_batch
from linkplan.studies.output.report_file import save_report
from linkplan.studies.variations.batch.batch_blocks import BatchOutcome, CasePlans
from linkplan.studies.variations.batch.block import Planned, case_blocks, packed, plan_block, unpacked
from linkplan.studies.variations.tasks.engine import Engine, Say, serial
from linkplan.studies.variations.tasks.streaming import complete
from linkplan.studies.variations.tasks.unfinished import finish, part, parts_folder, working

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
