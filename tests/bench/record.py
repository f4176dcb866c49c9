"""A record of answers, to compare a change of structure with: `python -m tests.bench.record FILE` writes it.

`python -m tests.bench.record FILE --against BEFORE` prints what differs from an earlier record. The record has the built-in
problems, random four-bars, sliders and linkages, and tables of the frequency response and of an experiment.
Each answer has its status, objective, duration and processor time. Answers are appended as they come, so that a run can be
continued; `--processes 2` takes about an hour on two cores. `--groups` and `--every N` choose a part. `--changed 1e-12`
changes every number of the problems' tables by that share of it.
"""

import argparse
import itertools
import json
import math
import multiprocessing
import re
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

# The seed of every random problem, and how many there are of each family; the seed of the cranks that turn fully.
SEED = 1
N_FOURBARS, N_SLIDERS, N_LINKAGES = 150, 60, 60
TURNING_SEED, N_TURNING = 4078, 24
# Objectives and durations of one problem that are no further apart than this are equal, relative.
EQUAL = 1e-6
# The mean processor time may grow to this share of what it was.
ALLOWED_TIME = 1.1
# From the best answer to the worst.
STATUSES = ("optimal", "feasible", "infeasible", "failed", "refused", "error")


def builtin_answer(name: str, change: float = 0.0) -> dict:
    """Return the answer to a built-in problem."""
    from linkplan.planner.files.tables import read_tables

    return tables_answer(read_tables(name)[1], change)


def fourbar_answer(number: str, change: float = 0.0) -> dict:
    """Return the answer to a random four-bar problem."""
    from tests.support.fourbar_problems import random_case

    return tables_answer(random_case(SEED, int(number)).tables, change)


def slider_answer(number: str, change: float = 0.0) -> dict:
    """Return the answer to a random slider-crank problem."""
    from tests.support.sliders import drawn

    return tables_answer(drawn(SEED, int(number)).tables, change)


def linkage_answer(number: str, change: float = 0.0) -> dict:
    """Return the answer to a random linkage problem."""
    from tests.support.linkage_problems import drawn

    return tables_answer(drawn(SEED, int(number)).tables, change)


def turning_answer(number: str, change: float = 0.0) -> dict:
    """Return the answer to a random four-bar's full turn in least time."""
    from tests.bench.contradictions import turning_case

    return tables_answer(turning_case(TURNING_SEED, int(number))[3], change)


def tables_answer(tables: dict, change: float = 0.0) -> dict:
    """Return the answer to the problem of some tables, with every number changed by a share of it."""
    from linkplan.planner.problem.problem import Problem
    from linkplan.planner.search.planning import plan_motion

    return answer_of(plan_motion(Problem.from_tables("recorded", changed(tables, change))))


def changed(value: Any, share: float) -> Any:
    """Return tables whose decimal numbers are larger or smaller by a share of them, also those of a model's text.

    The sign depends on the number alone, so that equal numbers remain equal.
    """
    if not share:
        return value
    if isinstance(value, dict):
        return {key: changed(item, share) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [changed(item, share) for item in value]
    if isinstance(value, float):
        return value * (1 + share * (1 if math.frexp(value)[0] * 64 % 2 < 1 else -1))
    if isinstance(value, str) and value.lstrip().startswith("<"):
        return re.sub(r"(?<![\w.])-?\d+\.\d+(?:[eE][-+]?\d+)?", lambda found: repr(changed(float(found[0]), share)), value)
    return value


def answer_of(plan) -> dict:
    """Return what is recorded of a plan."""
    duration = None if plan.trajectory is None else plan.trajectory.duration_s
    steps = [step.what for step in plan.history]
    answer = {"status": plan.status, "objective": plan.objective, "duration_s": duration, "message": plan.message}
    return answer | {"steps": steps}


def table_answer(words: str, _: float = 0.0) -> dict:
    """Return every number of a command's JSON, by its place; its problem's numbers are not changed."""
    import contextlib
    import io

    from linkplan.cli.main import main as linkplan

    with contextlib.redirect_stdout(io.StringIO()) as said, contextlib.redirect_stderr(io.StringIO()):
        code = linkplan([*words.split(), "--json"])
    return {"status": f"exit code {code}", "numbers": dict(numbers_in(json.loads(said.getvalue())))}


def numbers_in(value: object, place: str = "") -> Iterator[tuple[str, float]]:
    """Yield every number of a JSON value with its place; times of the machine are left out."""
    if isinstance(value, dict):
        for key, item in value.items():
            if key not in ("time_s", "history", "versions", "seconds", "run_time"):
                yield from numbers_in(item, f"{place}.{key}")
    elif isinstance(value, list):
        for k, item in enumerate(value):
            yield from numbers_in(item, f"{place}[{k}]")
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield place, float(value)


TABLES = (
    "bode knee-reach --at-deg O=3.6 --at-deg O=-40",
    "bode knee-sprint --along --tracker lqr",
    "bode five-bar-reach --tracker lqr --no-measure",
    "tune knee-reach --bandwidth-hz 5",
    "compare knee-reach",
    "compare five-bar-reach",
    "experiment knee-reach --samples 48 --trackers pd,pd+ff,lqr",
    "experiment slider-crank-turn --samples 32 --trackers pd+ff,lqr",
    "decompose knee-reach",
    "check optimus-knee",
    "check andrews-squeezer",
)

GROUPS: dict[str, tuple[Callable[[str, float], dict], Callable[[], list[str]]]] = {
    "builtin": (
        builtin_answer,
        lambda: sorted(path.stem for path in (Path(__file__).parents[2] / "planner" / "problems").glob("*.toml")),
    ),
    "fourbar": (fourbar_answer, lambda: [str(k) for k in range(N_FOURBARS)]),
    "slider": (slider_answer, lambda: [str(k) for k in range(N_SLIDERS)]),
    "linkage": (linkage_answer, lambda: [str(k) for k in range(N_LINKAGES)]),
    "turning": (turning_answer, lambda: [str(k) for k in range(N_TURNING)]),
    "table": (table_answer, lambda: list(TABLES)),
}


def recorded(group: str, name: str, change: float = 0.0) -> dict:
    """Return one line of the record, of a problem whose numbers are changed by a share of them."""
    from linkplan.models.errors import LinkplanError

    begin = time.process_time()
    try:
        answer = GROUPS[group][0](name, change)
    except LinkplanError as error:
        answer = {"status": "refused", "message": str(error)}
    except Exception as error:  # a fault is an answer to compare, too
        answer = {"status": "error", "message": repr(error)}
    return {"group": group, "name": name, **answer, "cpu_s": time.process_time() - begin}


def load_record(path: Path) -> dict[tuple[str, str], dict]:
    """Return a record's answers by group and name."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return {(answer["group"], answer["name"]): answer for answer in map(json.loads, lines)}


def differences(before: dict, now: dict) -> Iterator[str]:
    """Yield how an answer differs from an earlier one."""
    old, new = before["status"], now["status"]
    if old != new:
        known = old in STATUSES and new in STATUSES
        word = "worse" if not known or STATUSES.index(new) > STATUSES.index(old) else "better"
        yield f"status {old} -> {new} ({word}): {now.get('message', '')[:160]}"
    for key in ("objective", "duration_s"):
        if not _equal(before.get(key), now.get(key)):
            yield f"{key} {before.get(key)} -> {now.get(key)}"
    old, new = before.get("numbers", {}), now.get("numbers", {})
    changed = [place for place in {**old, **new} if not _equal(old.get(place), new.get(place))]
    if changed:
        first = changed[0]
        yield f"{len(changed)} of {len(old)} numbers, first {first}: {old.get(first)} -> {new.get(first)}"


def _equal(first: float | None, second: float | None) -> bool:
    if first is None or second is None:
        return first is second
    return math.isclose(first, second, rel_tol=EQUAL, abs_tol=1e-9)


def comparison(before: dict, now: dict) -> tuple[str, bool]:
    """Return the comparison of two records in words, and whether nothing got worse."""
    lines, worse = [], False
    common = [key for key in before if key in now]
    for key in common:
        found = list(differences(before[key], now[key]))
        worse = worse or any("(better)" not in line for line in found)
        lines += [f"{key[0]} {key[1]}: {line}" for line in found]
    lines.append("group      answers  mean processor time before [s]  now [s]  ratio")
    for group, members in itertools.groupby(sorted(common), key=lambda key: key[0]):
        keys = list(members)
        old, new = (sum(record[key]["cpu_s"] for key in keys) / len(keys) for record in (before, now))
        worse = worse or new > ALLOWED_TIME * old
        lines.append(f"{group:10s} {len(keys):7d}  {old:30.2f}  {new:7.2f}  {new / old:5.2f}")
    return "\n".join(lines), not worse


def main(words: list[str]) -> int:
    """Write a record, compare it, or both; 1 where an answer got worse."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.record", description=__doc__.split(":")[0])
    parser.add_argument("file", type=Path, help="the record, a file of JSON lines; what it has already is not done again")
    parser.add_argument("--against", type=Path, help="an earlier record")
    parser.add_argument("--groups", nargs="+", choices=list(GROUPS), default=list(GROUPS))
    parser.add_argument("--every", type=int, default=1, help="record every Nth answer of each group")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--changed", type=float, default=0.0, help="the share by which every number is changed")
    asked = parser.parse_args(words)
    known = load_record(asked.file)
    wanted = [(group, name) for group in asked.groups for name in GROUPS[group][1]()[:: asked.every]]
    missing = [key for key in wanted if key not in known]
    context = multiprocessing.get_context("spawn")
    with asked.file.open("a", encoding="utf-8") as out, ProcessPoolExecutor(asked.processes, mp_context=context) as pool:
        waiting = [pool.submit(recorded, *key, asked.changed) for key in missing]
        for done, future in enumerate(as_completed(waiting), start=1):
            answer = future.result()
            known[answer["group"], answer["name"]] = answer
            out.write(json.dumps(answer) + "\n")
            out.flush()
            said = f"{done}/{len(missing)} {answer['group']} {answer['name']}: {answer['status']}, {answer['cpu_s']:.1f} s"
            print(said, file=sys.stderr, flush=True)
    if asked.against is None:
        return 0
    text, fine = comparison(load_record(asked.against), {key: known[key] for key in wanted})
    print(text)
    return 0 if fine else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
