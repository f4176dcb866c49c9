"""An experiment's results on disk while it runs: parts that are complete or not there, whatever kills the process.

Beside the result's folder DIR stands DIR.unfinished with what was asked (asked.json), the plan, and parts/part-00000.parquet
and so on, one for each block that is done. Each is written under another name, waited for, and renamed. The next run of the
same command goes on from there; a run of another one is refused.
"""

import contextlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

from linkplan.models.errors import PlanFileError
from linkplan.models.interrupts import shielded
from linkplan.planner.files.folders import write_json, write_whole
from linkplan.planner.files.plan_folder import write_plan
from linkplan.planner.files.work_folders import sync_folder
from linkplan.planner.plan import Plan
from linkplan.studies.experiment.experiment import hash_of

try:
    import fcntl
except ImportError:  # not POSIX: two runs at once are not told apart
    fcntl = None

ASKED, PLAN, PARTS, _LOCK = "asked.json", "plan", "parts", "lock"


def unfinished(target: Path) -> Path:
    """Return where the parts of a result stand until it is whole."""
    return target.with_name(f"{target.name}.unfinished")


@contextlib.contextmanager
def working(folder: Path, asked: Mapping) -> Iterator[None]:
    """Hold a folder of parts for this process: made, or taken up where the same was asked.

    Raises:
        PlanFileError: when it holds another experiment's parts, or another process works on it.
    """
    lock, held = None, False
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT, 0o600)
        if fcntl is not None:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise PlanFileError(f"another process is at work on '{folder}'") from error
        held = True
        _compare(folder, asked)
        (folder / PARTS).mkdir(exist_ok=True)
        for left in (folder / PARTS).glob(".*"):  # a part that was being written when its process was killed
            left.unlink()
        yield
    except OSError as error:
        raise PlanFileError(f"cannot write '{folder}': {error.strerror or error}; what is done is kept") from error
    finally:
        if lock is not None:
            if held and not (folder / PLAN).exists() and not any(folder.glob(f"{PARTS}/part-*")):
                remove(folder)  # nothing came of it
            os.close(lock)


def _compare(folder: Path, asked: Mapping) -> None:
    path = folder / ASKED
    if not path.exists():
        strangers = [entry.name for entry in folder.iterdir() if entry.name not in (_LOCK, PLAN) and entry.name[0] != "."]
        if strangers:
            raise PlanFileError(f"'{folder}' holds '{strangers[0]}', which is no experiment's; move it away")
        _put_whole(path, lambda place: write_json(place, asked))
        return
    refuse_other(path, asked, f"'{folder}' holds the parts of another experiment")


def refuse_other(path: Path, asked: Mapping, what: str) -> None:
    """Refuse a folder whose record of what was asked is not this one, with the first thing that differs.

    Raises:
        PlanFileError: when something was asked otherwise.
    """
    try:
        held = json.loads(path.read_text(encoding="utf-8"))
        held = held.get("asked", held)
    except (OSError, ValueError, AttributeError) as error:
        raise PlanFileError(f"'{path}' cannot be read: {error}; name a new folder") from error
    if hash_of(held) == hash_of(asked):
        return
    differs = next(iter(_differences(held, asked)), "something")
    raise PlanFileError(f"{what} ({differs}); name a new folder, or remove it")


def _differences(held: object, asked: object, name: str = "") -> Iterator[str]:
    if isinstance(held, Mapping) and isinstance(asked, Mapping):
        for key in dict.fromkeys((*held, *asked)):
            yield from _differences(held.get(key), asked.get(key), f"{name}.{key}" if name else key)
    elif held != asked:
        yield f"{name.removeprefix('settings.')} was {held}, now {asked}"


def keep_plan(folder: Path, plan: Plan) -> None:
    """Write the plan into a folder of parts, whole."""
    if not (folder / PLAN).is_dir():
        write_whole(folder / PLAN, lambda place: write_plan(plan, place))


def done(folder: Path) -> set[int]:
    """Return the blocks whose parts are there."""
    return {int(path.stem.removeprefix("part-")) for path in (folder / PARTS).glob("part-*.parquet")}


def write_part(folder: Path, block: int, columns: Mapping[str, list]) -> None:
    """Write a block's results as its part: complete, or not at all."""
    import pyarrow.parquet as parquet

    table = _table(columns)
    _put_whole(folder / PARTS / f"part-{block:05d}.parquet", lambda place: parquet.write_table(table, place))


def write_results(folder: Path, path: Path, blocks: int) -> None:
    """Write all parts as one file, in their order."""
    import pyarrow.parquet as parquet

    names = [folder / PARTS / f"part-{block:05d}.parquet" for block in range(blocks)]
    with parquet.ParquetWriter(path, parquet.read_schema(names[0])) as writer:
        for name in names:
            writer.write_table(parquet.read_table(name))


def read_results(path: Path) -> dict:
    """Return the columns of a results file by name, as arrays (objects for words).

    Raises:
        PlanFileError: when it is none.
    """
    import pyarrow as pa
    import pyarrow.parquet as parquet

    try:
        table = parquet.read_table(path)
    except (OSError, pa.ArrowException) as error:
        raise PlanFileError(f"'{path}' holds no results: {str(error).splitlines()[0]}") from error
    return {name: table[name].to_numpy(zero_copy_only=False) for name in table.column_names}


def remove(folder: Path) -> None:
    """Remove a folder of parts whose result is whole."""
    for name in (PARTS, PLAN):
        shutil.rmtree(folder / name, ignore_errors=True)
    for name in (ASKED, _LOCK):
        (folder / name).unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # somebody put something into it
        folder.rmdir()


def _table(columns: Mapping[str, list]):
    import pyarrow as pa

    kinds = {"sample": pa.int64(), "tracker": pa.string(), "success": pa.bool_(), "failure": pa.string()}
    arrays = {name: pa.array(values, kinds.get(name, pa.float64())) for name, values in columns.items()}
    return pa.table(arrays)


def _put_whole(path: Path, write) -> None:
    """Write a file under another name, wait for the disk, and rename it."""
    work = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        write(work)
        with shielded():
            descriptor = os.open(work, os.O_RDWR)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
            os.replace(work, path)
            sync_folder(path.parent)
    finally:
        work.unlink(missing_ok=True)
