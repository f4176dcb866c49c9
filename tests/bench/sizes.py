"""The part of `make bench` on mechanisms: build and solve time against bodies, loops, degrees of freedom and intervals.

The built-in mechanisms, and random planar ones of the generator in tests/planar.py: of each number of loops one with a
fixed base and one that rides on a turning one, so of one and of two degrees of freedom. One first solve, interpreted; the
lesser of two processor times; the exponents are those of a straight line through the logarithms.
"""

import csv
import itertools
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from linkplan.models.kinematics import tied_points
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.reach import reach
from linkplan.planner.problem.limits import free_bounds
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.problem.settings import MeshSettings, SolverSettings
from linkplan.planner.solvers.solve import build_solver, run_solver
from linkplan.studies.output.text import table
from tests.bench.timing import first_program, say
from tests.support.planar import random_planar

INTERVALS = (20, 40, 80, 160, 320)
BUILT_IN = ("cart-pole-swing-up", "slider-crank-turn", "knee-reach", "knee-linear-reach", "five-bar-reach", "squeezer-turn")
# What each random mechanism is asked: this share of the way to its ends, at most so far [rad], in so many seconds.
_SHARE, _MOST, _DURATION_S = 0.4, 0.4, 1.0
# An effort map whose least singular value is below this share of its largest leaves a freedom without a drive.
_DRIVEN = 1e-3
_TIMES = 2
_SEEDS = 200
# A mechanism whose first solve takes more iterations than this is passed over: sizes are compared, not hardness.
_ITERATIONS = 60


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Size:
    """What one first solve took: on how many intervals, its build and solve times [s], its iterations, its answer."""

    intervals: int
    build_s: float
    solve_s: float
    iterations: int
    converged: bool


def n_loops(mechanism: Mechanism) -> int:
    """Return the number of loops: of pairs of bodies that active connects and welds join."""
    model = mechanism.model
    tied = (tied_points(model, int(index)) for index in np.flatnonzero(model.eq_active0))
    return len({frozenset(int(model.body_weldid[body]) for body, _ in points) for points in tied if points})


def n_bodies(mechanism: Mechanism) -> int:
    """Return the number of moving bodies, welded ones counted as one."""
    return len(set(np.asarray(mechanism.model.body_weldid).tolist()) - {0})


def random_problem(seed: int) -> Problem | None:
    """Return a reach of the random planar mechanism of a seed; None where no actuator drives one of its freedoms."""
    mechanism = load_mechanism(random_planar(seed).text)
    values = np.linalg.svd(np.array(mechanism.dynamics.effort_map(mechanism.home)), compute_uv=False)
    if len(values) < mechanism.dof or values[-1] < _DRIVEN * values[0]:
        return None
    start, goal = (mechanism.home[mechanism.independent].copy() for _ in range(2))
    can = reach(mechanism, 0)
    start[0] -= min(_MOST, _SHARE * (start[0] - can.lower.position))
    goal[0] += min(_MOST, _SHARE * (can.upper.position - goal[0]))
    names = [joint.name for joint in mechanism.independent_joints]
    given = {f"{end}_deg": dict(zip(names, np.degrees(s), strict=True)) for end, s in (("start", start), ("goal", goal))}
    problem = Problem.reach(mechanism, **given, duration_s=_DURATION_S, name=f"planar {seed}")
    free = {"effort": free_bounds(mechanism.n_u), "position": free_bounds(mechanism.n_q)}
    return problem.varied(limits=replace(problem.limits, **free))


def problems() -> Iterator[Problem]:
    """Yield the problems in the order of the table."""
    for name in BUILT_IN:
        yield load_problem(name)
    for loops, rides in itertools.product((1, 2, 3), (False, True)):
        for seed in range(_SEEDS):
            planar = random_planar(seed)
            problem = random_problem(seed) if (planar.n_loops, planar.rides) == (loops, rides) else None
            if problem is not None and one_size(problem, INTERVALS[0]).converged:
                yield problem
                break


def one_size(problem: Problem, intervals: int) -> Size:
    """Return what building and solving a problem once takes on so many intervals."""
    settings = MeshSettings(scheme=problem.mesh.scheme, intervals=intervals, effort=problem.mesh.effort)
    solver_settings = SolverSettings(compile="never", max_iterations=_ITERATIONS)
    asked = problem.varied(mesh=settings, solver=solver_settings)
    builds, solves = [], []
    for _ in range(_TIMES):
        begin = time.process_time()
        program = first_program(asked)
        solver = build_solver(program.program, solver_settings)
        built = time.process_time()
        solution = run_solver(solver, program)
        builds.append(built - begin)
        solves.append(time.process_time() - built)
    return Size(
        intervals=intervals,
        build_s=min(builds),
        solve_s=min(solves),
        iterations=solution.iterations,
        converged=solution.converged,
    )


def exponent(sizes: list[Size], name: str) -> float:
    """Return the exponent of a time in the number of intervals."""
    times = [getattr(size, name) for size in sizes]
    return float(np.polyfit(np.log([size.intervals for size in sizes]), np.log(times), 1)[0])


def bench_sizes(folder: Path, intervals: tuple[int, ...] = INTERVALS) -> str:
    """Return the table of times and exponents; every solve goes to `folder` as CSV."""
    rows, records = [], []
    for problem in problems():
        mechanism = problem.mechanism
        what = [problem.name, n_bodies(mechanism), n_loops(mechanism), mechanism.dof]
        say(f"sizes: {problem.name}")
        sizes = [one_size(problem, n) for n in intervals]
        records += [[*what, s.intervals, s.build_s, s.solve_s, s.iterations, s.converged] for s in sizes]
        build = [1e3 * size.build_s for size in sizes]
        solved = "yes" if all(size.converged for size in sizes) else "no"
        row = [
            *what,
            *build,
            exponent(sizes, "build_s"),
            *(1e3 * s.solve_s for s in sizes),
            exponent(sizes, "solve_s"),
            solved,
        ]
        rows.append(row)
    with (folder / "sizes.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(
            ["problem", "bodies", "loops", "dof", "intervals", "build [s]", "solve [s]", "iterations", "converged"]
        )
        writer.writerows(records)
    head = ["problem", "bodies", "loops", "dof"]
    head += [f"build {n} [ms]" for n in intervals] + ["exponent"]
    head += [f"solve {n} [ms]" for n in intervals]
    head += ["exponent", "solved"]
    return table(head, rows)
