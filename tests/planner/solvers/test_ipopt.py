"""IPOPT: its options, when a solve is given up, and warm solves."""
# ruff: noqa: ARG005 - the signature of a problem's functions is what the problem says it is

import time
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from linkplan.models.compiled.functions import compiler
from linkplan.models.errors import ProblemError
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.closed_chain.transcribe import Transcribed, transcribe
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.problem.settings import SolverSettings
from linkplan.planner.solvers import solve as module
from linkplan.planner.solvers import solve as solvers
from linkplan.planner.solvers.solve import INVALID, OUT_OF_ITERATIONS, OUT_OF_TIME, SUCCEEDED, Solution, solve, why_stopped
from linkplan.planner.transcription.mesh import uniform
from tests.support.first_order import FirstOrder
from tests.support.plans import problem_of


def transcribed(problem: Problem) -> Transcribed:
    """Return the program of a problem on a small mesh."""
    guess = first_guess(problem, problem.start_pose())
    return transcribe(problem, guess, uniform(20), np.array([guess.duration_s]))


@pytest.mark.parametrize(
    "rate",
    [lambda x, u, t: [x[1], u[0] + ca.sqrt(-1 - x[0] ** 2)], lambda x, u, t: [x[1], u[0] + ca.log(0.5 - x[0])]],
    ids=["everywhere", "beyond a state"],
)
def test_dynamics_that_give_no_number_end_in_a_status_and_silence(rate, capfd):
    problem = FirstOrder(
        rate=rate, start=[0, 0], goal=[1, 0], effort_limit=[[-10, 10]], duration_s=3.0,
        running_cost=lambda x, u, t: u[0] ** 2,
    )  # fmt: skip
    found = solve(problem.transcribed(20))
    assert not found.converged
    assert found.status == INVALID
    assert "NaN" in why_stopped(found.status, 1.0)
    said = capfd.readouterr()
    assert said.out == ""
    assert said.err == ""


@pytest.mark.parametrize(("more", "status"), [({"max_time_s": 1e-6}, OUT_OF_TIME), ({"max_iterations": 2}, None)])
def test_a_solver_that_runs_out_of_time_or_iterations_says_so_and_has_no_answer(more, status):
    solution = solve(transcribed(problem_of("knee-reach", "solver.compile=never")), SolverSettings(**more))
    assert not solution.converged
    assert status is None or solution.status == status


def test_bounds_that_contradict_each_other_end_in_a_status():
    program = transcribed(problem_of("knee-reach"))
    lower = np.array(program.lower)
    lower[program.program.layout.effort()[0]] = 2 * program.upper[program.program.layout.effort()[0]]
    assert not solve(replace(program, lower=lower)).converged


@pytest.mark.parametrize("name", ["fatrop", "ipopt", "snopt"])
def test_a_problem_that_names_its_solver_is_told_that_the_key_is_gone(name):
    with pytest.raises(ProblemError, match=r"unknown key 'solver\.name': linkplan always uses IPOPT; this key was removed"):
        load_problem("knee-reach", [f"solver.name={name}"])


needs_compiler = pytest.mark.skipif(compiler() is None, reason="this machine has no C compiler")


def programmed(*settings: str):
    """Return the settings and the program of a reach on few intervals."""
    problem = load_problem("knee-reach", [*settings, "mesh.intervals=8"])
    guess = first_guess(problem, problem.start_pose())
    return problem.solver, transcribe(problem, guess, uniform(8), np.array([guess.duration_s]))


@pytest.fixture(autouse=True)
def cold(tmp_path, monkeypatch):
    monkeypatch.setenv("LINKPLAN_CACHE", str(tmp_path))


@pytest.mark.slow
@needs_compiler
def test_a_solve_that_takes_long_ends_compiled_and_to_the_last_bit_where_the_interpreter_ends(monkeypatch):
    monkeypatch.setattr(module, "_COMPILING_COST", 1)
    monkeypatch.setattr(module, "_MIN_PATIENCE_ITERATIONS", 3)
    slow = solve(*reversed(programmed("solver.compile=never")))
    settings, program = programmed()
    assert slow.iterations > 3
    assert not program.program.interval.compiled
    quick = solve(program, settings)
    assert quick.transcribed.program.interval.compiled
    assert (quick.status, quick.iterations) == (slow.status, slow.iterations)
    np.testing.assert_array_equal(quick.x, slow.x)


def test_a_short_one_stays_interpreted():
    settings, program = programmed()
    found = solve(program, settings)
    assert found.converged
    assert not found.transcribed.program.interval.compiled


def test_building_and_solving_are_parts_of_the_time_that_the_call_takes():
    settings, program = programmed()
    begin = time.perf_counter()
    found = solve(program, settings)
    assert found.build_s > 0.0
    assert found.solve_s > 0.0
    assert found.build_s + found.solve_s <= time.perf_counter() - begin


NOTHING = Solution(
    transcribed=None,
    x=np.zeros(1),
    objective=1.0,
    converged=False,
    status=OUT_OF_ITERATIONS,
    iterations=500,
    build_s=0,
    solve_s=0,
)


@pytest.mark.parametrize("again", [SUCCEEDED, OUT_OF_ITERATIONS])
def test_rounding_does_not_end_a_search_where_another_barrier_finds_the_motion(again, monkeypatch):
    asked = []

    def solved(_, settings, *, adaptive=False, **__):
        asked.append((adaptive, settings.max_iterations))
        found = replace(NOTHING, objective=2.0, converged=again == SUCCEEDED, status=again)
        return found if adaptive else NOTHING

    monkeypatch.setattr(solvers, "_patience", lambda *_: None)
    monkeypatch.setattr(solvers, "_solved", solved)
    solution = solve(None, SolverSettings(max_iterations=200))
    assert [adaptive for adaptive, _ in asked] == [False, True]
    assert asked[1][1] <= asked[0][1]
    assert solution.objective == (2.0 if again == SUCCEEDED else 1.0)
