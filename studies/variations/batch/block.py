"""The unit of work of a batch: a block of consecutive cases, each planned from the previous case's solution.

The blocks depend on the number of cases only, so that every plan is reproducible.
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct, field

from linkplan.models.errors import PlanFileError, one_line
from linkplan.planner.files.columns import read_trajectory
from linkplan.planner.files.folders import plain_record
from linkplan.planner.files.tables import PLAN_FILES
from linkplan.planner.plan.folder import record_of, write_plan
from linkplan.planner.plan.record import read_plan_record
from linkplan.planner.problem.keys.sections import BatchFile, CaseSection
from linkplan.planner.refinement.history import Say
from linkplan.planner.search.batch import plan_cases
from linkplan.studies.variations.batch.batch_blocks import CaseRow, case_row
from linkplan.studies.variations.tasks.streaming import blocks_of

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
                write_plan(plan, Path(place), target / case.name, parquet=parquet)
                files = {path.name: path.read_bytes() for path in sorted(Path(place).iterdir())}
        failure = None if plan.passed else f"{case.name}: {plan.message}"
        said = {"settings": list(case.set), **plain_record(record_of(plan))}
        answer = Planned(name=case.name, row=case_row(case, plan), record=said, failure=failure, files=files)
        found.append(answer)
    return found


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
            _unpack(answer, place / answer.name)
    except (msgspec.MsgspecError, ValueError, PlanFileError) as error:
        why = one_line(error)
        raise PlanFileError(
            f"'{path}' is damaged: {why}; remove it and run the same command again to plan its cases"
        ) from error
    return answers


def _unpack(answer: Planned, folder: Path) -> None:
    """Write the files of a case's plan into its folder, and check that the plan can be read.

    Raises:
        ValueError: if a file is not that of a plan.
        PlanFileError: if a file is damaged.
    """
    if others := sorted(answer.files.keys() - set(PLAN_FILES)):
        raise ValueError(f"'{answer.name}/{others[0][:100]}' is not a file of its plans")
    for name, content in answer.files.items():
        folder.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
    if answer.failure is None:
        read_plan_record(folder)
        read_trajectory(folder / "trajectory.npz")
