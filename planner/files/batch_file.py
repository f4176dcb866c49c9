"""Batch files: many problems that vary one.

A batch file is TOML: `problem`, a built-in name or a file; `set`, settings for all of them; then `[[case]]` tables with
`name` and
`set` (a list of "key=value"), or a `[sweep]` table of key = list of values, of which every combination is a case.
"""

import itertools
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from linkplan.models.catalogue import is_folder, is_there, nearest_source
from linkplan.models.errors import ProblemError
from linkplan.models.names import nearest
from linkplan.models.reading import read_toml
from linkplan.planner.files.problem_file import beside
from linkplan.planner.files.tables import BUILT_IN as PROBLEMS
from linkplan.planner.files.tables import refuse_saved_plan
from linkplan.planner.files.toml_text import inline

KEYS = ("problem", "set", "case", "sweep")
CASE_KEYS = ("name", "set")
# More cases than this are a slip of the keyboard: at a fifth of a second each they take half an hour.
MAX_CASES = 10_000


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Case:
    """One problem of a batch: its name, fit for a folder, and its settings ("key=value") on the batch's problem."""

    name: str
    settings: tuple[str, ...]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Batch:
    """A problem, settings on it that are common to all, and the cases that vary it."""

    problem: str
    common: tuple[str, ...]
    cases: tuple[Case, ...]


def read_batch(path: str | Path) -> Batch:
    """Return the batch in a file.

    Raises:
        ProblemError: for anything in the file that cannot be used.
    """
    path = Path(path)
    legal = "a batch is a TOML file with problem, and [[case]] or [sweep]"
    refuse_saved_plan(str(path), "batch", legal)
    if is_folder(path):
        raise ProblemError(f"batch '{path}' is a folder; {legal}")
    if not is_there(path):
        raise ProblemError(f"batch '{path}'{nearest_source(str(path), ())} is not a file; {legal}")
    tables = read_toml(path, f"batch '{path}'")
    if "motion" in tables and "problem" not in tables:
        raise ProblemError(f"batch '{path}' is a problem file, which plan takes; {legal}")
    for key in tables:
        if key not in KEYS:
            raise ProblemError(f"unknown key '{key}' in a batch{nearest(key, KEYS)}; keys are {', '.join(KEYS)}")
    problem = tables.get("problem")
    if not isinstance(problem, str) or not problem:
        raise ProblemError(f"problem of a batch is a built-in name or a TOML file, got {problem!r}")
    if problem not in PROBLEMS:
        problem = str(beside(problem, path.parent))
    common = _settings(tables.get("set", []), "set")
    if ("case" in tables) == ("sweep" in tables):
        raise ProblemError("a batch has [[case]] tables or a [sweep] table, one of the two")
    listed = _listed(tables["case"]) if "case" in tables else _swept(tables["sweep"])
    cases = tuple(Case(name=name, settings=settings) for name, settings in listed)
    names = [case.name for case in cases]
    twice = sorted(name for name, times in Counter(names).items() if times > 1)
    if twice:
        raise ProblemError(f"cases of a batch have names of their own; twice: {', '.join(twice)}")
    return Batch(problem=problem, common=common, cases=cases)


def _settings(value: object, where: str) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise ProblemError(f'{where} of a batch is a list of "key=value", got {value!r}')
    return tuple(value)


def _listed(value: object) -> Iterator[tuple[str, tuple[str, ...]]]:
    if not isinstance(value, list) or not value or not all(isinstance(item, dict) for item in value):
        raise ProblemError(f"case of a batch is a list of tables ([[case]]), got {value!r}")
    if len(value) > MAX_CASES:
        raise ProblemError(f"a batch has {MAX_CASES} cases at the most, got {len(value)}")
    for number, item in enumerate(value):
        for key in item:
            if key not in CASE_KEYS:
                raise ProblemError(f"unknown key 'case.{key}'{nearest(key, CASE_KEYS)}; keys are {', '.join(CASE_KEYS)}")
        name = item.get("name", f"case-{number + 1}")
        if not isinstance(name, str) or not _is_a_folder_name(name):
            raise ProblemError(f"case.name is a word that can name a folder, got {name!r}")
        yield name, _settings(item.get("set", []), f"set of case '{name}'")


def _is_a_folder_name(name: str) -> bool:
    return (
        name.isprintable()
        and bool(name)
        and name[0] != "."
        and not set(name) & set('/\\:*?"<>|')
        and len(name.encode()) < 100
    )


def _swept(value: object) -> list[tuple[str, tuple[str, ...]]]:
    if not isinstance(value, dict) or not value:
        raise ProblemError(f"sweep of a batch is a table of key = list of values, got {value!r}")
    axes = []
    for key, values in _flat(value):
        if not isinstance(values, list) or not values:
            raise ProblemError(f"sweep.{key} is a list of values, got {values!r}")
        axes.append([(key, item) for item in values])
    total = 1
    for axis in axes:
        total *= len(axis)
    if total > MAX_CASES:
        raise ProblemError(f"a batch has {MAX_CASES} cases at the most, the sweep makes {total}")
    cases = []
    for number, combination in enumerate(itertools.product(*axes)):
        settings = tuple(f"{key}={inline(item)}" for key, item in combination)
        cases.append((f"{number + 1:0{len(str(total))}d}", settings))
    return cases


def _flat(table: dict, prefix: str = "") -> Iterator[tuple[str, object]]:
    """Yield dotted keys, whether they were quoted or TOML made tables of them."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
