"""The part of a batch's record, `batch.json`, that is read back."""

from pathlib import Path

import msgspec
from msgspec import Struct

from linkplan.models.reading import MAX_FILE_BYTES
from linkplan.planner.files.json_record import read_record


class CaseRecord(Struct, frozen=True):
    """A case: its settings and its result."""

    settings: list[str]
    status: str
    message: str
    objective: float | None = None
    objective_kind: str = ""
    duration_s: float | None = None
    notes: list[str] = []


class BatchRecord(Struct, frozen=True):
    """The cases of a batch by name."""

    cases: dict[str, CaseRecord]


def read_batch_record(path: Path) -> dict:
    """Return the part of a batch's record that a report shows, in JSON types.

    Raises:
        PlanFileError: if the file is damaged, or is not a batch's record.
    """
    return msgspec.to_builtins(read_record(path, BatchRecord, MAX_FILE_BYTES))
