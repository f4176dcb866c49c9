"""An experiment's results as files: a block's part, all parts in one, and the columns of that."""

from collections.abc import Mapping
from pathlib import Path

from linkplan.models.errors import PlanFileError
from linkplan.planner.files.folders import write_whole
from linkplan.planner.files.plan_folder import write_plan
from linkplan.planner.files.work_folders import replace_file
from linkplan.planner.plan import Plan
from linkplan.studies.tasks.unfinished import PLAN, part


def keep_plan(folder: Path, plan: Plan) -> None:
    """Write the plan into a folder of parts, whole."""
    if not (folder / PLAN).is_dir():
        write_whole(folder / PLAN, lambda place: write_plan(plan, place))


def write_part(folder: Path, block: int, columns: Mapping[str, list]) -> None:
    """Write a block's results as its part: complete, or not at all."""
    import pyarrow.parquet as parquet

    table = _table(columns)
    replace_file(part(folder, block, "parquet"), lambda place: parquet.write_table(table, place))


def write_results(folder: Path, path: Path, blocks: int) -> None:
    """Write all parts as one file, in their order."""
    import pyarrow.parquet as parquet

    names = [part(folder, block, "parquet") for block in range(blocks)]
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


def _table(columns: Mapping[str, list]):
    import pyarrow as pa

    kinds = {"sample": pa.int64(), "tracker": pa.string(), "success": pa.bool_(), "failure": pa.string()}
    arrays = {name: pa.array(values, kinds.get(name, pa.float64())) for name, values in columns.items()}
    return pa.table(arrays)
