"""IPOPT behind one call: a word where there is no answer, and no key that asks for another solver."""

# ruff: noqa: ARG005 - the signature of a problem's functions is what the problem says it is

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from linkplan.models.errors import ProblemError
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.closed_chain.transcribe import Transcribed, transcribe
from linkplan.planner.ode.plan import plan_ode
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.problem.settings import SolverSettings
from linkplan.planner.solvers.solve import INVALID, OUT_OF_TIME, solve
from linkplan.planner.transcription.mesh import uniform
from tests.support.plans import problem_of


def transcribed(problem: Problem) -> Transcribed:
    """Return the program of a problem on a small mesh."""
    guess = first_guess(problem, problem.start_pose())
    return transcribe(problem, guess, uniform(20), np.array([guess.duration_s]))


@pytest.mark.parametrize(
    "rate",
    [lambda x, u, p, t: [x[1], u[0] + ca.sqrt(-1 - x[0] ** 2)], lambda x, u, p, t: [x[1], u[0] + ca.log(0.5 - x[0])]],
    ids=["everywhere", "beyond a state"],
)
def test_dynamics_that_give_no_number_end_in_a_status_and_silence(rate, capfd):
    problem = OdeProblem(
        name="not a number",
        rate=rate,
        start=[0, 0],
        goal=[1, 0],
        effort_limit=[[-10, 10]],
        duration_s=3.0,
        running_cost=lambda x, u, p, t: u[0] ** 2,
    )
    plan = plan_ode(problem)
    assert plan.status == "failed"
    assert "NaN" in plan.message
    assert plan.history[-1].solver_status == INVALID
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
    with pytest.raises(ProblemError, match=r"unknown key 'solver\.name': linkplan solves with IPOPT, and this key is gone"):
        load_problem("knee-reach", [f"solver.name={name}"])
