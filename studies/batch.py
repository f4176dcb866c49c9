"""A batch of plans as a table: what was asked, what came of it."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from planner.batch import Case, plan_batch, read_batch
from planner.folders import check_target, write_json, write_whole
from planner.plan import Plan
from planner.plan_folder import record, write_plan
from studies.tables import table


def batch_record(results: Sequence[tuple[Case, Plan]]) -> dict:
    """Return a batch's results by case."""
    return {"cases": {case.name: {"settings": list(case.settings), **record(plan)} for case, plan in results}}


def batch_text(results: Sequence[tuple[Case, Plan]]) -> str:
    """Return a batch's results as a table, and a line for each case without a plan."""
    rows = []
    for case, plan in results:
        duration = None if plan.trajectory is None else plan.trajectory.duration_s
        peak = None if plan.certificate is None else float(plan.certificate.peak_effort.max())
        seconds = sum(step.build_s + step.solve_s for step in plan.history)
        warm = "again" if plan.history and plan.history[-1].what == "solved again" else "anew"
        rows.append([case.name, " ".join(case.settings), plan.status, plan.objective, duration, peak, seconds, warm])
    head = ["case", "set", "status", "objective", "duration [s]", "peak effort", "solver [s]", "solved"]
    lines = [table(head, rows)]
    lines += [f"{case.name}: {plan.message}" for case, plan in results if plan.status != "optimal"]
    return "\n".join(lines)


def run_batch(arguments: argparse.Namespace) -> tuple[dict, str, bool]:
    """Plan the cases of a batch file; return the record, the text, and whether every case has a plan."""
    target = None if arguments.output is None else Path(arguments.output)
    if target is not None:
        check_target(target, "batch.json")
    batch = read_batch(arguments.batch)

    def say(text: str) -> None:
        print(f"  batch: {text}", file=sys.stderr, flush=True)

    results = list(plan_batch(batch, say))
    said = batch_record(results)
    if target is not None:

        def write(place: Path) -> None:
            write_json(place / "batch.json", said)
            for case, plan in results:
                if plan.status == "optimal":
                    (place / case.name).mkdir()
                    write_plan(plan, place / case.name, target / case.name)

        write_whole(target, write, "batch.json")
        say(f"saved in {target}")
    return said, batch_text(results), all(plan.status == "optimal" for _, plan in results)
