"""JSON records written by linkplan, read back as typed values."""

from pathlib import Path
from typing import TypeVar

import msgspec

from linkplan.models.errors import PlanFileError
from linkplan.models.reading import read_file, too_deep

# The records of plans, experiments and reports have some hundred kilobytes.
MAX_RECORD_BYTES = 8_000_000
Record = TypeVar("Record")


def read_record(path: Path, kind: type[Record], max_bytes: int = MAX_RECORD_BYTES) -> Record:
    """Return the record in a JSON file as a value of one type.

    Args:
        path: the file.
        kind: a msgspec type; keys that it does not name are ignored.
        max_bytes: the file's largest size.

    Raises:
        PlanFileError: when the file is missing, too large, truncated, nested more than a hundred levels deep, or has values
            of
            other types.
    """
    content = read_file(path, f"'{path}'", max_bytes, PlanFileError)
    # In memory, a table takes thirty times its size in JSON. Records have a table or a list for every forty bytes.
    containers, most = content.count(b"{") + content.count(b"["), max_bytes // 20
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
