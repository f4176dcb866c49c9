"""Plan random four-bar problems: `python -m tests.bench.random_fourbars [N] [SEED]`.

Answers are appended to a file of JSON lines (`--out`) as they come; problems that are in it already are left out, so that a
run may be broken off and taken up again. `--only` plans given numbers anew and prints what their histories say.
"""

import argparse
import collections
import json
import multiprocessing
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import numpy as np

from linkplan.models.errors import LinkplanError
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from tests.support.fourbar_problems import KINDS, Case, kind_of, random_case

# A least time against the phase plane's, relative: both sides' own errors are below 1e-7.
LEAST_TIME = 1e-6
# The shortest feasible duration that an infeasible plan names, relative.
SHORTEST = 1e-3


def judge(case: Case, plan: Plan) -> str:
    """Return "right", or what is wrong with an answer, in a word or two."""
    if plan.status == "optimal":
        if plan.certificate is None or not plan.certificate.passed:
            return "certificate"
        if not case.feasible:
            return "planned the impossible"
        return "right" if case.duration is None else _timed(case, plan.trajectory.duration_s)
    if plan.trajectory is not None and plan.status == "infeasible":
        return "a motion though infeasible"
    if case.feasible:
        return "failed" if plan.status == "failed" else "called infeasible"
    if plan.status == "failed":
        return "infeasible, failed"
    if case.shortest is not None and "duration_s" in case.tables["motion"] and _fixed(case):
        named = plan.verdict.remedy.get("motion.duration_s")
        if named is None:
            return "infeasible, shortest not named"
        if abs(named / case.shortest - 1) > SHORTEST:
            return "infeasible, shortest wrong"
    return "right"


def _fixed(case: Case) -> bool:
    return case.tables["motion"]["duration_s"] != "free"


def _timed(case: Case, duration: float) -> str:
    off = duration / case.duration - 1
    if abs(off) <= LEAST_TIME:
        return "right"
    return "slower than the least time" if off > 0 else "faster than the least time"


def answer(seed: int, number: int) -> dict:
    """Return the record of one problem, planned and judged."""
    case = random_case(seed, number)
    begun, begun_cpu = time.perf_counter(), time.process_time()

    def spent() -> dict:
        return {"seconds": time.perf_counter() - begun, "cpu_seconds": time.process_time() - begun_cpu}

    record = {"number": number, "seed": seed, "kind": case.kind, "feasible": case.feasible}
    record |= {"duration": case.duration, "shortest": case.shortest, "notes": case.notes}
    try:
        plan = plan_motion(Problem.from_tables(f"{case.kind} {number}", case.tables))
    except LinkplanError as error:
        return record | {"verdict": "refused", "message": str(error)} | spent()
    except Exception as error:  # what must never come: noted and judged, not hidden
        return record | {"verdict": "error", "message": repr(error)} | spent()
    steps = [
        (s.what, s.scheme, s.intervals, s.segments, s.solver_status, s.objective, s.solve_s, s.integration_error_deg)
        for s in plan.history
    ]
    return record | {
        "verdict": judge(case, plan),
        "status": plan.status,
        "message": plan.message,
        "planned": plan.trajectory.duration_s if plan.trajectory is not None else None,
        "named": plan.verdict.remedy.get("motion.duration_s"),
        "steps": steps,
        **spent(),
    }


def summary(records: list[dict]) -> str:
    """Return counts by kind and verdict, the share of the feasible ones that were solved, and the times."""
    feasible = [r for r in records if r["feasible"]]
    solved = [r for r in feasible if r.get("status") == "optimal" and r["verdict"] != "certificate"]
    lines = [f"{len(records)} problems; {len(solved)} of {len(feasible)} feasible ones solved"]
    lines[0] += f" ({100 * len(solved) / max(len(feasible), 1):.2f} %)"
    for (kind, verdict), n in sorted(collections.Counter((r["kind"], r["verdict"]) for r in records).items()):
        lines.append(f"  {kind:20s} {verdict:32s} {n}")
    for name, what in (("seconds", "seconds a plan"), ("cpu_seconds", "of the processor")):
        seconds = np.array([r[name] for r in records])
        shares = ", ".join(f"{q} %: {np.percentile(seconds, q):.2f}" for q in (50, 90, 99, 100))
        lines.append(f"  {what}: mean {seconds.mean():.2f}, {shares}")
    return "\n".join(lines)


def main(arguments: list[str]) -> int:
    """Plan, judge and sum up; 0 where every answer is right."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.random_fourbars", description=__doc__.split(":")[0])
    parser.add_argument("n", nargs="?", type=int, default=1000, help="how many problems (1000)")
    parser.add_argument("seed", nargs="?", type=int, default=1, help="of the random numbers (1)")
    parser.add_argument("--first", type=int, default=0, help="the number to begin with (0)")
    parser.add_argument("--out", type=Path, default=Path("random-fourbars.jsonl"), help="file of answers, added to")
    parser.add_argument("--processes", type=int, default=1, help="how many plan at a time (1)")
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS), help="problems of these kinds alone")
    parser.add_argument("--only", type=int, nargs="*", help="plan these numbers anew, print what their histories say")
    asked = parser.parse_args(arguments)
    if asked.only:
        for number in asked.only:
            print(json.dumps(answer(asked.seed, number), indent=1))
        return 0
    known = {}
    if asked.out.exists():
        lines = asked.out.read_text(encoding="utf-8").splitlines()
        known = {r["number"]: r for r in map(json.loads, lines) if r["seed"] == asked.seed}
    numbers = [k for k in range(asked.first, asked.first + asked.n) if kind_of(asked.seed, k) in asked.kinds]
    context = multiprocessing.get_context("spawn")
    with (
        asked.out.open("a", encoding="utf-8") as out,
        ProcessPoolExecutor(max_workers=asked.processes, mp_context=context) as pool,
    ):
        waiting = [pool.submit(answer, asked.seed, number) for number in numbers if number not in known]
        for done, future in enumerate(as_completed(waiting), start=1):
            record = future.result()
            known[record["number"]] = record
            out.write(json.dumps(record) + "\n")
            out.flush()
            print(
                f"{done}/{len(waiting)} number {record['number']}: {record['kind']}, {record['verdict']},"
                f" {record['seconds']:.2f} s",
                file=sys.stderr,
                flush=True,
            )
    records = [known[number] for number in numbers]
    print(summary(records))
    return 0 if all(r["verdict"] == "right" for r in records) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
