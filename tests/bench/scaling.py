"""The part of `make bench` on size: building, solving and memory over the number of intervals, each in its own process."""

import csv
import json
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from linkplan.planner.problem.problem import load_problem
from linkplan.planner.solvers.solve import build_solver, run_solver
from linkplan.studies.output.figure import BLUE, GREEN, GREY, PURPLE, page
from linkplan.studies.output.text import table
from tests.bench.timing import first_program, first_solve, own_cache, say

INTERVALS = (50, 100, 200, 500, 1000, 2000)
# The exponent is that of the larger meshes, where what does not depend on size no longer counts.
_FROM = 200
_KILOBYTES = 1024.0  # a megabyte; ru_maxrss is in kilobytes


def one_size(intervals: int) -> dict[str, float]:
    """Return what one first solve of knee-reach takes: build and solve [s], iterations, this process's peak memory [MB]."""
    settings = ["solver.compile=always"]
    first_solve(load_problem("knee-reach", [*settings, "mesh.intervals=10"]))  # what is loaded once
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    problem = load_problem("knee-reach", [*settings, f"mesh.intervals={intervals}"])
    begin = time.process_time()
    program = first_program(problem)
    built = build_solver(program.program, problem.solver)
    middle = time.process_time()
    solution = run_solver(built, program)
    end = time.process_time()
    assert solution.converged, solution.status
    stats = built.stats()
    return {
        "build_s": middle - begin,
        "solve_s": end - middle,
        "evaluation_s": sum(value for name, value in stats.items() if name.startswith("t_proc_nlp")),
        "iterations": solution.iterations,
        "before_mb": before / _KILOBYTES,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _KILOBYTES,
    }


def bench_scaling(folder: Path) -> str:
    """Return times and memory over intervals with their exponents; CSV and figure go to `folder`."""
    found: list[dict[str, float]] = []
    with own_cache():
        first_solve(load_problem("knee-reach", ["solver.compile=always"]))  # compiled once, for all that follow
        for n in INTERVALS:
            say(f"scaling: {n} intervals")
            command = [sys.executable, "-m", "tests.bench.scaling", str(n)]
            found.append(json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout))
    rows = []
    for n, r in zip(INTERVALS, found, strict=True):
        per = 1e3 * r["solve_s"] / r["iterations"]
        rows.append([n, 1e3 * r["build_s"], 1e3 * r["solve_s"], int(r["iterations"]), per, r["peak_mb"]])
    large = [k for k, n in enumerate(INTERVALS) if n >= _FROM]
    sizes = np.log([INTERVALS[k] for k in large])

    def slope(values: list[float]) -> float:
        return float(np.polyfit(sizes, np.log(values)[large], 1)[0])

    exponent = slope([r["solve_s"] for r in found])
    build, each = slope([r["build_s"] for r in found]), slope([r["solve_s"] / r["iterations"] for r in found])
    rows.append([f"exponent from {_FROM}", build, exponent, None, each, None])
    with (folder / "scaling.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["intervals", *found[0]])
        writer.writerows([n, *r.values()] for n, r in zip(INTERVALS, found, strict=True))
    draw(found, exponent, folder / "scaling.png")
    head = [
        "knee-reach, Radau-3, compiled",
        "build [ms]",
        "solve [ms]",
        "iterations",
        "an iteration [ms]",
        "peak memory [MB]",
    ]
    return table(head, rows)


def draw(found: list[dict[str, float]], exponent: float, path: Path) -> None:
    """Draw times and memory over the number of intervals."""
    with page(path, 1, 2, size=(10.0, 4.2)) as axes:
        times, memory = axes[0]
        label = f"solve (exponent {exponent:.2f})"
        times.loglog(INTERVALS, [r["solve_s"] for r in found], "o-", color=BLUE, label=label)
        peak = [r["peak_mb"] - r["before_mb"] for r in found]
        memory.loglog(INTERVALS, np.maximum(peak, 0.1), "o-", color=BLUE)
        sizes = np.array(INTERVALS)
        times.loglog(sizes, [r["build_s"] for r in found], "s--", color=GREEN, label="build")
        times.loglog(sizes, [r["evaluation_s"] for r in found], "^--", color=PURPLE, label="evaluation in the solve")
        linear = sizes / sizes[-1] * found[-1]["solve_s"]
        times.loglog(sizes, linear, ":", color=GREY, label="proportional to intervals")
        times.set_ylabel("processor time [s]")
        memory.set_ylabel("peak memory beyond a small solve's [MB]")
        for ax in (times, memory):
            ax.set_xlabel("intervals (Radau, 3 nodes each)")
        times.legend(fontsize=8)


if __name__ == "__main__":
    print(json.dumps(one_size(int(sys.argv[1]))))
