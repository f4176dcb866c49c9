"""The part of `make bench` on work and precision: every transcription's true error against its solve time, beside Opti.

One solve on uniform meshes, nothing refined. True errors: of the state, the angle after integrating the planned torque at
tolerance 1e-12 (the certificate's); of the objective, against a fine reference where the motion is smooth and against
the exact least time where it is bang-bang.
"""

import csv
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from linkplan.models.errors import AssemblyError
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.closed_chain.transcribe import trajectory_of
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.solvers.solve import build_solver, run_solver
from linkplan.planner.transcription.schemes import MAX_DEGREE, NAMES, scheme
from linkplan.studies.output.figure import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED, page
from linkplan.studies.output.text import table
from tests.bench.opti_peer import build_peer, drift
from tests.bench.timing import EXACT_TIME, GOAL, START, first_program, say

INTERVALS = (5, 10, 20, 40, 80)
# A mesh of more nodes than this teaches nothing more: errors are at rounding by then.
_MOST_NODES = 200
PEER_INTERVALS = (5, 10, 20, 40, 80, 160)
PROBLEMS = {"knee-reach": 0.16, "knee-sprint": None}  # and the duration asked [s]
PEER = "Opti, Hermite-Simpson"
PLAN = "the whole plan, refined"
# Errors below this are the reference's own, or rounding.
_FLOOR = 1e-13


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Point:
    """One solve: by what, on how many intervals, its time [ms], its state's error [deg], its objective."""

    problem: str
    scheme: str
    intervals: int
    solve_ms: float
    state_deg: float
    objective: float


def solve_once(problem_name: str, scheme_name: str, intervals: int) -> Point | None:
    """Return one of our solves, None where it did not converge or its motion cannot be followed."""
    settings = [f"mesh.scheme={scheme_name}", f"mesh.intervals={intervals}", "solver.compile=always"]
    problem = load_problem(problem_name, settings)
    program = first_program(problem)
    solver = build_solver(program.program, problem.solver)
    taken, solution = _least_s(lambda: run_solver(solver, program))
    if not solution.converged:
        return None
    try:
        certificate = certify(problem, trajectory_of(program, solution.x, problem.limits.effort))
    except AssemblyError:
        return None
    return Point(
        problem=problem_name,
        scheme=scheme_name,
        intervals=intervals,
        solve_ms=1e3 * taken,
        state_deg=certificate.integration_error_deg,
        objective=solution.objective,
    )


def solve_peer(problem_name: str, intervals: int) -> Point:
    """Return one of Opti's solves, both of its errors by the same measures."""
    peer = build_peer(intervals, START, GOAL, PROBLEMS[problem_name])
    taken, solution = _least_s(lambda: peer.solve(GOAL))
    return Point(
        problem=problem_name,
        scheme=PEER,
        intervals=intervals,
        solve_ms=1e3 * taken,
        state_deg=float(np.degrees(drift(peer, solution))),
        objective=float(solution.value(peer.opti.f)),
    )


def plan_whole(problem_name: str) -> Point:
    """Return what the planner makes of a problem by itself, refined and certified, with all the time that it takes."""
    problem = load_problem(problem_name, ["solver.compile=always"])
    plan_motion(problem)  # what is compiled once
    taken, plan = _least_s(lambda: plan_motion(problem).require())
    return Point(
        problem=problem_name,
        scheme=PLAN,
        intervals=plan.history[-1].intervals,
        solve_ms=1e3 * taken,
        state_deg=plan.certificate.integration_error_deg,
        objective=plan.objective,
    )


def _least_s(work: Callable[[], Any]) -> tuple[float, Any]:
    """Return the lesser processor time [s] of doing work twice, and what came of it."""
    times = []
    for _ in range(2):
        begin = time.process_time()
        found = work()
        times.append(time.process_time() - begin)
    return min(times), found


def measure(folder: Path) -> tuple[list[Point], dict[str, float]]:
    """Return all solves, and each problem's best objective; compiled functions are kept in `folder` for the next run."""
    os.environ["LINKPLAN_CACHE"] = str(folder.resolve())
    points, best = [], {"knee-sprint": EXACT_TIME["knee-sprint"]}
    for problem_name in PROBLEMS:
        say(f"work and precision: {problem_name}, Opti")
        points += [solve_peer(problem_name, intervals) for intervals in PEER_INTERVALS]
        points.append(plan_whole(problem_name))
        for name in NAMES:
            say(f"work and precision: {problem_name}, {name}")
            sizes = [n for n in INTERVALS if n * scheme(name).n_nodes <= _MOST_NODES]
            points += [point for n in sizes if (point := solve_once(problem_name, name, n)) is not None]
    fine = solve_once("knee-reach", f"gauss-{MAX_DEGREE}", 40)
    assert fine is not None
    best["knee-reach"] = fine.objective
    del os.environ["LINKPLAN_CACHE"]
    return points, best


def bench_precision(folder: Path) -> str:
    """Return each scheme's finest mesh in a table; all of it goes to `folder` as CSV and figure."""
    points, best = measure(folder / "cache")
    with (folder / "work-precision.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["problem", "scheme", "intervals", "solve [ms]", "state error [deg]", "objective error"])
        for p in points:
            error = p.objective / best[p.problem] - 1
            writer.writerow([p.problem, p.scheme, p.intervals, f"{p.solve_ms:.4g}", f"{p.state_deg:.4g}", f"{error:.4g}"])
    draw(points, best, folder / "work-precision.png")
    rows = []
    for name in (PEER, PLAN, *NAMES):
        row: list[object] = [name]
        for problem in PROBLEMS:
            mine = [p for p in points if (p.problem, p.scheme) == (problem, name)]
            last = max(mine, key=lambda p: p.intervals)
            row += [last.intervals, last.solve_ms, last.state_deg, last.objective / best[problem] - 1]
        rows.append(row)
    head = ["finest uniform mesh, no refinement"]
    for short in ("reach", "sprint"):
        head += [f"{short}: intervals", "solve [ms]", "state error [deg]", "objective error"]
    return table(head, rows)


FORMS = {"trapezoid": BLUE, "hermite-simpson": ORANGE, "trapezoid-consistent": GREEN, "hermite-simpson-consistent": PURPLE}


def draw(points: list[Point], best: dict[str, float], path: Path) -> None:
    """Draw both errors over the solve time: problems and errors in rows, families of schemes in columns."""
    import matplotlib as mpl

    shades = mpl.colormaps["viridis"](np.linspace(0.0, 0.92, MAX_DEGREE))
    families = {
        "trapezoid and Hermite-Simpson": [(name, colour, name) for name, colour in FORMS.items()],
        "Radau": [(f"radau-{d}", shades[d - 1], f"{d}") for d in range(1, MAX_DEGREE + 1)],
        "Gauss-Legendre": [(f"gauss-{d}", shades[d - 1], f"{d}") for d in range(1, MAX_DEGREE + 1)],
    }
    quantities = [
        ("knee-reach", "state", "knee-reach (smooth):\nstate's error [deg]"),
        ("knee-reach", "objective", "knee-reach (smooth):\neffort's relative error"),
        ("knee-sprint", "state", "knee-sprint (bang-bang):\nstate's error [deg]"),
        ("knee-sprint", "objective", "knee-sprint (bang-bang):\nleast time's relative error"),
    ]

    def curve(problem: str, name: str, what: str):
        mine = sorted((p for p in points if (p.problem, p.scheme) == (problem, name)), key=lambda p: p.intervals)
        if what == "state":
            return [p.solve_ms for p in mine], [max(p.state_deg, _FLOOR) for p in mine]
        return [p.solve_ms for p in mine], [max(abs(p.objective / best[problem] - 1), _FLOOR) for p in mine]

    with page(path, 4, 3, size=(12.0, 13.0), sharex=True, sharey="row") as axes:
        for place, (row, (problem, what, label)) in enumerate(zip(axes, quantities, strict=True)):
            row[0].set_ylabel(label)
            for ax, (title, members) in zip(row, families.items(), strict=True):
                for name, colour, shown in members:
                    ax.loglog(*curve(problem, name, what), "o-", color=colour, markersize=3.5, linewidth=1.2, label=shown)
                ax.loglog(*curve(problem, PEER, what), "s--", color=BLACK, markersize=4, linewidth=1.4, label=PEER)
                ax.loglog(*curve(problem, PLAN, what), "*", color=RED, markersize=13, label=PLAN)
                if place == 0:
                    few = len(members) < MAX_DEGREE
                    ax.set_title(title, pad=58)
                    ax.legend(
                        loc="lower center",
                        bbox_to_anchor=(0.5, 1.0),
                        ncols=2 if few else 5,
                        fontsize=7.5,
                        frameon=False,
                        title=None if few else "nodes an interval",
                        title_fontsize=8,
                    )
                if place == len(quantities) - 1:
                    ax.set_xlabel("time of one solve [ms], 5 to 80 intervals\n(Opti: 5 to 160; the plan: all of its time)")
