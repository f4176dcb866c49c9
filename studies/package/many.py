"""`batch`: many variations of one problem, each planned from the solution of the one before it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from linkplan.paths import path_of
from linkplan.planner.files.folders import plain_record
from linkplan.planner.problem.settings import plain
from linkplan.reporting import Progress, listener
from linkplan.studies.batch.study import Outcome, run_batch
from linkplan.studies.output.batch_table import batch_blocks
from linkplan.studies.output.text import html_of, text_of
from linkplan.studies.tasks.cluster import engine_of


def batch(
    cases: str | Path | Mapping,
    folder: str | Path | None = None,
    *,
    workers: int = 1,
    cluster: str | None = None,
    parquet: bool = False,
    progress: Progress | None = None,
) -> BatchResult:
    """Return the plans of many variations of one problem, as a table and a record; write them if a folder is given.

    Args:
        cases: the path of a batch file, or its table: `problem` (a built-in name or a problem file), `set` (settings for all
            cases), and either `sweep`, lists of values by dotted key whose combinations are the cases, or `case`, a list of
            tables with `name` and `set`. Keys have their units in their names.
        folder: for the plans, written whole. Finished parts are kept next to it, and the same call continues from them.
        workers: number of processes; more than one needs `if __name__ == "__main__":` in the caller's module.
        cluster: the address of a Dask scheduler, whose workers share the work.
        parquet: whether every plan also has a trajectory.parquet.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: for an invalid case, before any case is planned, or if the folder has other files.

    Example::

        linkplan.batch({"problem": "knee-reach", "sweep": {"motion.duration_s": [0.16, 0.2]}})
    """
    from linkplan.planner.files.batch_file import batch_from, read_batch

    engine = engine_of(workers, cluster)
    asked = batch_from(plain(cases), Path()) if isinstance(cases, Mapping) else read_batch(path_of(cases, "cases"))
    target = None if folder is None else path_of(folder, "folder")
    return BatchResult(outcome=run_batch(asked, target, listener(progress), engine=engine, parquet=parquet))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class BatchResult:
    """The plans of a batch. `str(result)` is the table; `to_dict()` has every case's record, with units in the names."""

    outcome: Outcome

    @property
    def passed(self) -> bool:
        """Whether every case has a certified plan."""
        return not self.outcome.failures

    @property
    def failures(self) -> tuple[str, ...]:
        """A sentence for each case without a plan."""
        return tuple(self.outcome.failures)

    def to_dict(self) -> dict:
        """Return the settings and the record of every case by name, in JSON types."""
        return plain_record(self.outcome.record)

    def _repr_html_(self) -> str:
        return html_of(batch_blocks(self.outcome.rows, self.outcome.failures))

    def __str__(self) -> str:
        return text_of(batch_blocks(self.outcome.rows, self.outcome.failures))

    def __repr__(self) -> str:
        return f"BatchResult({len(self.outcome.rows)} cases, {len(self.outcome.failures)} without a plan)"
