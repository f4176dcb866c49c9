"""Batch files: many variations of one problem.

A batch file is TOML. `problem` is a built-in name or a file, and `set` holds settings for all cases. The cases are
`[[case]]` tables with `name` and `set` (a list of "key=value"), or every combination of a `[sweep]` table of key = list of
values.
"""

import itertools
import os
import unicodedata
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from msgspec.structs import replace

from linkplan.models.catalogue import nearest_source
from linkplan.models.errors import ProblemError
from linkplan.models.reading import read_toml
from linkplan.planner.files.tables import BUILT_IN as PROBLEMS
from linkplan.planner.files.tables import inline, refuse_saved_plan, resolve_path
from linkplan.planner.problem.keys.reading import read
from linkplan.planner.problem.keys.sections import BatchFile, CaseSection

# More cases are probably a typing error: at a fifth of a second each they take half an hour.
MAX_CASES = 10_000


def read_batch(path: str | Path) -> BatchFile:
    """Return the batch in a file, with the problem's path and every case, listed or swept.

    Raises:
        ProblemError: for anything in the file that cannot be used.
    """
    path = Path(path)
    return batch_from(_batch_tables(path), path.parent)


def batch_from(tables: dict, folder: Path) -> BatchFile:
    """Return the batch of a file's tables; the problem's path is looked up in `folder` before the working folder.

    Raises:
        ProblemError: for anything in the tables that cannot be used.
    """
    asked = read(BatchFile, tables, "")
    problem = asked.problem
    if problem not in PROBLEMS and "\n" not in problem:
        problem = str(resolve_path(problem, folder))
    if ("case" in tables) == ("sweep" in tables):
        raise ProblemError("a batch must have either [[case]] tables or a [sweep] table")
    if len(asked.case) > MAX_CASES:
        raise ProblemError(f"a batch must have at most {MAX_CASES} cases, got {len(asked.case)}")
    listed = [(case.name or f"case-{k + 1}", case.set) for k, case in enumerate(asked.case)] or _swept(asked.sweep)
    names = [name for name, _ in listed]
    for name in names:
        if not name.isprintable() or len(name.encode()) >= 100:  # disks limit file names to 255 bytes, with suffixes
            raise ProblemError(f"case.name must be a valid name of a folder, got {name!r}")
    alike = Counter(map(_on_disk, names))
    twice = sorted({name for name in names if alike[_on_disk(name)] > 1})
    if twice:
        raise ProblemError(
            f"names of a batch's cases must differ, in more than upper and lower case; used twice: {', '.join(twice)}"
        )
    return replace(asked, problem=problem, case=[CaseSection(name=name, set=settings) for name, settings in listed])


def _batch_tables(path: Path) -> dict:
    """Return a batch file's tables; refuse other files."""
    legal = "a batch is a TOML file with problem, and [[case]] or [sweep]"
    refuse_saved_plan(str(path), "batch", legal)
    if os.path.isdir(path):
        raise ProblemError(f"batch '{path}' is a folder; {legal}")
    if not os.path.exists(path):
        raise ProblemError(f"batch '{path}'{nearest_source(str(path), ())} is not a file; {legal}")
    tables = read_toml(path, f"batch '{path}'")
    if "motion" in tables and "problem" not in tables:
        raise ProblemError(f"batch '{path}' is a problem file, for plan; {legal}")
    if "problem" not in tables:
        raise ProblemError(f"batch '{path}' names no problem; {legal}")
    return tables


def _on_disk(name: str) -> str:
    """Return a name as compared by file systems that ignore case and normal forms of Unicode."""
    return unicodedata.normalize("NFC", name).casefold()


def _swept(table: dict) -> list[tuple[str, list[str]]]:
    axes = []
    for key, values in _flat(table):
        if not isinstance(values, list) or not values:
            raise ProblemError(f"sweep.{key} must be a list of one or more values, got {values!r}")
        axes.append([(key, item) for item in values])
    total = 1
    for axis in axes:
        total *= len(axis)
    if total > MAX_CASES:
        raise ProblemError(f"a batch must have at most {MAX_CASES} cases; the sweep has {total}")
    cases = []
    for number, combination in enumerate(itertools.product(*axes)):
        settings = [f"{key}={inline(item)}" for key, item in combination]
        cases.append((f"{number + 1:0{len(str(total))}d}", settings))
    return cases


def _flat(table: dict, prefix: str = "") -> Iterator[tuple[str, object]]:
    """Yield dotted keys, whether they were quoted or parsed by TOML into nested tables."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
