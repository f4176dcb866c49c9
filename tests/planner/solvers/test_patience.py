"""A long solve on interpreted functions is given up for compiled ones, which lead it the same way."""

import time

import numpy as np
import pytest

from linkplan.models.compiled.functions import compiler
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.closed_chain.transcribe import transcribe
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.solvers import solve as module
from linkplan.planner.solvers.solve import OUT_OF_ITERATIONS, solve
from linkplan.planner.transcription.mesh import uniform

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


@pytest.mark.parametrize(("compile_mode", "most"), [("never", None), ("auto", 3)])
def test_one_that_may_not_be_compiled_or_may_take_few_iterations_is_begun_once(compile_mode, most, monkeypatch):
    monkeypatch.setattr(module, "_COMPILING_COST", 1)
    monkeypatch.setattr(module, "_MIN_PATIENCE_ITERATIONS", 3)
    settings, program = programmed(f"solver.compile={compile_mode}")
    found = solve(program, settings.replace(max_iterations=most))
    assert not found.transcribed.program.interval.compiled
    assert (found.status == OUT_OF_ITERATIONS) == (most == 3)
