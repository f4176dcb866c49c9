"""Result folders: written whole or not at all."""

import json
import math
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from linkplan.models.errors import PlanFileError

# A folder that holds one of these is a result of ours and may be replaced by a newer one.
RECORDS = ("plan.json", "track.json", "compare.json", "bode.json", "tune.json", "check.json", "demo.json", "batch.json")


def check_target(target: Path, record: str = "plan.json") -> None:
    """Refuse a target that could not be written later: before long work begins, not after it.

    A folder may be replaced that holds an older result of the same kind, known by its `record`.

    Raises:
        PlanFileError: when the target is a file, or a folder with things in it that are not ours, or its parent cannot
            be written.
    """
    if target.exists() and not target.is_dir():
        raise PlanFileError(f"a result is a folder; '{target}' is a file")
    if target.is_dir() and any(target.iterdir()) and not (target / record).is_file():
        other = [name for name in RECORDS if (target / name).is_file()]
        held = f"another result ({', '.join(other)})" if other else "files that are not linkplan's"
        raise PlanFileError(f"'{target}' holds {held}; name a new or an empty folder")
    parent = target.absolute().parent
    while not parent.exists():
        parent = parent.parent
    if not parent.is_dir():
        raise PlanFileError(f"'{target}' lies below '{parent}', which is a file")


def write_whole(target: Path, write: Callable[[Path], None], record: str = "plan.json") -> None:
    """Write a folder by `write(folder)` beside its place, then move it there; on any failure nothing is left.

    Raises:
        PlanFileError: when the disk refuses.
    """
    check_target(target, record)
    target = target.absolute()
    work = None
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
        fresh = work / "new"
        fresh.mkdir()
        write(fresh)
        if target.exists():
            target.rename(work / "old")
        try:
            fresh.rename(target)
        except OSError:
            if (work / "old").exists():
                (work / "old").rename(target)
            raise
    except OSError as error:
        raise PlanFileError(f"cannot write '{target}': {error.strerror or error}") from error
    finally:
        if work is not None:
            shutil.rmtree(work, ignore_errors=True)


def plain(value: object) -> object:
    """Return `value` in JSON's own types: arrays as lists, numbers that are not finite as null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.bool_ | bool):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def plain_record(record: Mapping) -> dict:
    """Return a record in JSON's own types."""
    return {str(key): plain(item) for key, item in record.items()}


def write_json(path: Path, record: Mapping) -> None:
    """Write a record as indented JSON."""
    path.write_text(json.dumps(plain_record(record), indent=2, allow_nan=False) + "\n", encoding="utf-8")
