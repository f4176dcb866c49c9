"""The part of `make bench` on where time goes: function evaluation, linear algebra, and Python, in a plan and a re-solve."""

import contextlib
import itertools
import statistics
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from linkplan.planner.certificate.certificate import certify
from linkplan.planner.closed_chain.case import finished
from linkplan.planner.closed_chain.transcribe import renumbered, trajectory_of
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search.presolve import plain_contradiction
from linkplan.planner.solvers import solve as solving
from linkplan.planner.solvers.solve import Solver, build_solver, run_solver
from linkplan.studies.output.text import table
from tests.bench.timing import first_program, own_cache, say

_REPEATS = 9


class Timed:
    """A solver that notes the time [s] of its calls, and of the program's functions in them."""

    def __init__(self, solver: Solver) -> None:
        self._solver = solver
        self.whole, self.evaluation = 0.0, 0.0

    def __call__(self, **numbers: Any) -> Any:
        """Return the solver's answer."""
        begin = time.process_time()
        answer = self._solver(**numbers)
        self.whole = time.process_time() - begin
        self.evaluation = sum(value for name, value in self.stats().items() if name.startswith("t_proc_nlp"))
        return answer

    def stats(self) -> dict[str, Any]:
        """Return the solver's stats."""
        return self._solver.stats()

    def parts(self, around_s: float) -> dict[str, float]:
        """Return the time [s] of the last call by parts, Python's from the time around it."""
        return {"evaluation": self.evaluation, "linear algebra": self.whole - self.evaluation, "call": around_s - self.whole}


@contextlib.contextmanager
def timed_solves() -> Iterator[list[float]]:
    """Note the processor time [s] of every call of a solver, in a list."""
    spent, build = [], solving.build_solver

    def timed_solver(*given: Any, **settings: Any) -> Any:
        solver = Timed(build(*given, **settings))

        def call(**numbers: Any) -> Any:
            answer = solver(**numbers)
            spent.append(solver.whole)
            return answer

        call.stats = solver.stats
        return call

    solving.build_solver = timed_solver
    try:
        yield spent
    finally:
        solving.build_solver = build


def whole_plan(problem: Problem) -> tuple[Plan, dict[str, float]]:
    """Return the plan of a problem that needs no refinement, by the planner's own steps, and the time [s] of each."""
    times, begin = {}, time.process_time()

    def lap(name: str) -> None:
        nonlocal begin
        now = time.process_time()
        times[name] = times.get(name, 0.0) + now - begin
        begin = now

    plain_contradiction(problem)
    program = first_program(problem)
    lap("build")
    solver = Timed(build_solver(program.program, problem.solver))
    lap("build")
    solution = run_solver(solver, program)
    lap("solve")
    trajectory = trajectory_of(program, solution.x, problem.limits.effort)
    certificate = certify(problem, trajectory)
    plan = finished(problem, trajectory, certificate, solution.objective, [], None)
    lap("certificate")
    return plan, times | solver.parts(times.pop("solve"))


def re_solves(problem: Problem, goals) -> list[dict[str, float]]:
    """Return the times [s] of solving a built program again for other goals."""
    program = first_program(problem)
    solver = Timed(build_solver(program.program, problem.solver, warm=True))
    last, found = run_solver(build_solver(program.program, problem.solver), program).x, []
    for goal in goals:
        begin = time.process_time()
        asked = problem.varied(motion=replace(problem.motion, goal=np.array([goal])))
        numbered = renumbered(program, asked, last)
        numbers = time.process_time()
        solution = run_solver(solver, numbered)
        solved = time.process_time()
        assert solution.converged
        last = solution.x
        found.append({"numbers": numbers - begin} | solver.parts(solved - numbers))
    return found


def bench_shares() -> str:
    """Return the shares of evaluation, linear algebra and Python in one plan, one solve and one re-solve of knee-reach."""
    rows = []
    with own_cache():
        say("shares of time")
        problem = load_problem("knee-reach", ["solver.compile=always"])
        whole_plan(problem)
        plans = [whole_plan(problem)[1] for _ in range(_REPEATS)]
        goals = list(itertools.islice(itertools.cycle(np.radians([55.0, 56.27])), 2 * _REPEATS))
        again = re_solves(problem, goals)[2:]
        rows.append(["one plan", *_shares(plans, ("build", "certificate", "call"))])
        rows.append(["its solve", *_shares(plans, ("call",))])
        rows.append(["one re-solve", *_shares(again, ("numbers", "call"))])
    head = [
        "knee-reach, compiled",
        "median [ms]",
        "evaluation [%]",
        "linear algebra [%]",
        "Python and its calls [%]",
        "of which",
    ]
    return table(head, rows)


def _shares(runs: list[dict[str, float]], ours: tuple[str, ...]) -> list[object]:
    """Return the median time [ms], the shares of evaluation, linear algebra and `ours` [%], and `ours` one by one."""
    names = ("evaluation", "linear algebra", *ours)
    middle = {name: statistics.median(run[name] for run in runs) for name in names}
    whole = sum(middle.values())
    python = sum(middle[name] for name in ours)
    words = ", ".join(f"{name} {100 * middle[name] / whole:.0f}" for name in ours)
    shares = [100 * value / whole for value in (middle["evaluation"], middle["linear algebra"], python)]
    return [1e3 * whole, *shares, words]
