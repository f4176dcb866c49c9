"""`batch`: many variations of one problem, each planned from the previous solution."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from linkplan.api.command import command
from linkplan.api.reporting import Progress, listener
from linkplan.models.errors import ProblemError
from linkplan.planner.problem.phases import PhasedProblem
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import to_toml_types
from linkplan.studies.output.paths import check_flags, path_of
from linkplan.studies.variations.batch.batch_blocks import BatchOutcome
from linkplan.studies.variations.batch.study import run_batch
from linkplan.studies.variations.tasks.cluster import engine_of


@command("plan the cases of a batch file, each starting from the previous solution")
def batch(
    cases: str | Path | Mapping,
    folder: str | Path | None = None,
    *,
    workers: int = 1,
    cluster: str | None = None,
    parquet: bool = False,
    progress: Progress | None = None,
) -> BatchOutcome:
    """Return the plans of many variations of one problem, as a table and a record; write them if a folder is given.

    Args:
        cases: the path of a batch file, or its table: `problem` (a built-in name or a problem file), `set` (settings for all
            cases), and either `sweep`, lists of values by dotted key whose combinations are the cases, or `case`, a list of
            tables with `name` and `set`. Keys have their units in their names. `problem` may be a `Problem`.
        folder: the folder for the plans, written completely or not at all. Finished parts are kept next to it, and the
            same call continues from them.
        workers: number of processes on this machine. More than one needs
            `if __name__ == "__main__":` in the caller's module.
        cluster: the address of a Dask scheduler, such as tcp://head:8786, whose workers share the work.
        parquet: whether every plan also has a trajectory.parquet.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: for an invalid case, before any case is planned, or if the folder has other files.

    Example::

        linkplan.batch({"problem": "knee-reach", "sweep": {"motion.duration_s": [0.16, 0.2]}})
    """
    from linkplan.planner.search.batch_file import batch_from, read_batch

    check_flags(parquet=parquet)
    engine = engine_of(workers, cluster)
    if isinstance(cases, Mapping):
        problem = cases.get("problem")
        if isinstance(problem, Problem | PhasedProblem):
            if isinstance(problem, Problem) and problem.extras:
                raise ProblemError(
                    f"a batch needs problems that a file can contain; '{problem.name}' has costs or limits given as Python"
                    " expressions"
                )
            cases = {**cases, "problem": problem.to_toml()}
        asked = batch_from(to_toml_types(cases), Path())
    else:
        asked = read_batch(path_of(cases, "cases"))
    target = None if folder is None else path_of(folder, "folder")
    return run_batch(asked, target, listener(progress), engine=engine, parquet=parquet)
