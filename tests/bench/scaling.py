"""The part of `make bench` on size: building, solving and memory over the number of intervals, each in its own process."""

import csv
import json
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from linkplan.planner.files.problem_file import load_problem
from linkplan.planner.solvers.solve import build_solver, run_solver
from linkplan.studies.output.drawing import BLUE, GREEN, GREY, ORANGE, PURPLE, page
from linkplan.studies.output.tables import table
from tests.bench.timing import first_program, first_solve, own_cache, say

# CasADi takes the square of the intervals to set FATROP up: beyond 500 that is most of the time.
INTERVALS = {"ipopt": (50, 100, 200, 500, 1000, 2000), "fatrop": (50, 100, 200, 500)}
# The exponent is that of the larger meshes, where what does not depend on size no longer counts.
_FROM = 200
_KILOBYTES = 1024.0  # a megabyte; ru_maxrss is in kilobytes


def one_size(intervals: int, solver: str) -> dict[str, float]:
    """Return what one first solve of knee-reach takes: build and solve [s], iterations, this process's peak memory [MB]."""
    settings = ["solver.compile=always", f"solver.name={solver}"]
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
    found: dict[str, list[dict[str, float]]] = {"ipopt": [], "fatrop": []}
    with own_cache():
        first_solve(load_problem("knee-reach", ["solver.compile=always"]))  # compiled once, for all that follow
        for solver, results in found.items():
            for n in INTERVALS[solver]:
                say(f"scaling: {n} intervals, {solver}")
                command = [sys.executable, "-m", "tests.bench.scaling", str(n), solver]
                results.append(json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout))
    rows, exponents = [], {}
    for solver, results in found.items():
        for n, r in zip(INTERVALS[solver], results, strict=True):
            per = 1e3 * r["solve_s"] / r["iterations"]
            rows.append([f"{solver}, {n}", 1e3 * r["build_s"], 1e3 * r["solve_s"], int(r["iterations"]), per, r["peak_mb"]])
        large = [k for k, n in enumerate(INTERVALS[solver]) if n >= _FROM]
        sizes = np.log([INTERVALS[solver][k] for k in large])

        def slope(values: list[float], sizes=sizes, large=large) -> float:
            return float(np.polyfit(sizes, np.log(values)[large], 1)[0])

        exponents[solver] = slope([r["solve_s"] for r in results])
        build, each = slope([r["build_s"] for r in results]), slope([r["solve_s"] / r["iterations"] for r in results])
        rows.append([f"{solver}, exponent from {_FROM}", build, exponents[solver], None, each, None])
    with (folder / "scaling.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["solver", "intervals", *found["ipopt"][0]])
        for solver, results in found.items():
            writer.writerows([solver, n, *r.values()] for n, r in zip(INTERVALS[solver], results, strict=True))
    draw(found, exponents, folder / "scaling.png")
    head = [
        "knee-reach, Radau-3, compiled",
        "build [ms]",
        "solve [ms]",
        "iterations",
        "an iteration [ms]",
        "peak memory [MB]",
    ]
    return table(head, rows)


def draw(found: dict[str, list[dict[str, float]]], exponents: dict[str, float], path: Path) -> None:
    """Draw times and memory over the number of intervals."""
    with page(path, 1, 2, size=(10.0, 4.2)) as axes:
        times, memory = axes[0]
        for solver, colour in (("ipopt", BLUE), ("fatrop", ORANGE)):
            label = f"solve, {solver.upper()} (exponent {exponents[solver]:.2f})"
            times.loglog(INTERVALS[solver], [r["solve_s"] for r in found[solver]], "o-", color=colour, label=label)
            peak = [r["peak_mb"] - r["before_mb"] for r in found[solver]]
            memory.loglog(INTERVALS[solver], np.maximum(peak, 0.1), "o-", color=colour, label=solver.upper())
        sizes, ipopt = np.array(INTERVALS["ipopt"]), found["ipopt"]
        times.loglog(sizes, [r["build_s"] for r in ipopt], "s--", color=GREEN, label="build, for IPOPT")
        times.loglog(sizes, [r["evaluation_s"] for r in ipopt], "^--", color=PURPLE, label="evaluation in IPOPT's solve")
        linear = sizes / sizes[-1] * ipopt[-1]["solve_s"]
        times.loglog(sizes, linear, ":", color=GREY, label="proportional to intervals")
        times.set_ylabel("processor time [s]")
        memory.set_ylabel("peak memory beyond a small solve's [MB]")
        for ax in (times, memory):
            ax.set_xlabel("intervals (Radau, 3 nodes each)")
            ax.legend(fontsize=8)


if __name__ == "__main__":
    print(json.dumps(one_size(int(sys.argv[1]), sys.argv[2])))
