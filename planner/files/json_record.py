"""JSON records that linkplan wrote, read back as the type that they were written from."""

from pathlib import Path
from typing import TypeVar

import msgspec

from linkplan.models.errors import PlanFileError
from linkplan.models.reading import read_file, too_deep

# The records of plans, experiments and reports have some hundred kilobytes.
MAX_RECORD_BYTES = 8_000_000
# A table of one key takes thirty times its seven bytes of JSON. Records have a table or a list for every forty bytes.
_BYTES_A_CONTAINER = 20
Record = TypeVar("Record")


def read_record(path: Path, kind: type[Record], max_bytes: int = MAX_RECORD_BYTES) -> Record:
    """Return the record in a JSON file as a value of one type.

    Args:
        path: of the file.
        kind: a msgspec type. Keys that it does not name are skipped.
        max_bytes: the file's largest size.

    Raises:
        PlanFileError: when the file is missing, too large, truncated, nested more than a hundred levels deep, or holds
            values of other types.
    """
    content = read_file(path, f"'{path}'", max_bytes, PlanFileError)
    containers, most = content.count(b"{") + content.count(b"["), max_bytes // _BYTES_A_CONTAINER
    if containers > most:
        raise PlanFileError(f"'{path}' has {containers} tables and lists; at most {most} are read")
    try:
        record = msgspec.json.decode(content, type=kind)
    except msgspec.ValidationError as error:
        raise PlanFileError(f"'{path}' is not a record that linkplan wrote: {error}") from error
    except (ValueError, RecursionError) as error:
        raise PlanFileError(f"'{path}' is truncated or not JSON: {error}") from error
    if too_deep(msgspec.structs.asdict(record) if isinstance(record, msgspec.Struct) else record):
        raise PlanFileError(f"'{path}' is nested too deeply")
    return record
