"""The record of a batch, `batch.json`, as far as it is read back."""

from pathlib import Path

import msgspec
from msgspec import Struct

from linkplan.planner.files.json_record import read_record

# The record of ten thousand cases has 40 MB, of which a hundredth is read.
_MAX_BYTES = 64_000_000


class CaseRecord(Struct, frozen=True):
    """What is read of a case: what was asked, and what came of it."""

    settings: list[str]
    status: str
    message: str
    objective: float | None = None
    objective_kind: str = ""
    duration_s: float | None = None
    notes: list[str] = []


class BatchRecord(Struct, frozen=True):
    """What is read of a batch: its cases by name."""

    cases: dict[str, CaseRecord]


def read_batch_record(path: Path) -> dict:
    """Return a batch's record in JSON's own types, as far as a report shows it.

    Raises:
        PlanFileError: when the file is damaged or none of a batch.
    """
    return msgspec.to_builtins(read_record(path, BatchRecord, _MAX_BYTES))
