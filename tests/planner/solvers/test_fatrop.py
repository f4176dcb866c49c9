"""FATROP by option: IPOPT's answers to the same problems, the same promises, and a word where there is no answer."""

# ruff: noqa: ARG005 - the signature of a problem's functions is what the problem says it is

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from linkplan.models.errors import ProblemError
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.closed_chain.transcribe import Transcribed, transcribe
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.ode.solve_ocp import plan_ode
from linkplan.planner.planning import plan_motion
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.problem.settings import SolverSettings
from linkplan.planner.replan import Planner
from linkplan.planner.search.presolve import start_pose_of
from linkplan.planner.solvers.solve import INVALID, OUT_OF_TIME, solve
from linkplan.planner.transcription.mesh import segmented, uniform
from tests.support.plans import planned, problem_of

# Two solvers on one program, each asked for 1e-10, relative. Measured 3e-14; 3e-11 where the objective has kinks.
SAME_ANSWER = 1e-8
# Where smoothing is taken out by continuation, two solvers end it at a hair's different meshes. Measured 6e-8.
SAME_WITHOUT_SMOOTHING = 1e-6
# An optimum against its closed form, relative: the solver's complementarity leaves 1e-9.
CLOSED_FORM = 1e-8
# A bound that binds, in the program's units: the solver's complementarity leaves 1e-10 over a multiplier of order one.
BINDS = 1e-8
FATROP, IPOPT = SolverSettings(name="fatrop"), SolverSettings()

DOUBLE_INTEGRATOR = OdeProblem(
    name="double integrator in least time",
    rate=lambda x, u, p, t: [x[1], u[0]],
    start=[0, 0],
    goal=[1, 0],
    effort_limit=[[-1, 1]],
    duration_s=(0.1, 10),
    final_cost=lambda x0, xT, T, p: T,
)
KIRK = OdeProblem(
    name="Kirk 5.1-1",
    rate=lambda x, u, p, t: [x[1], -x[1] + u[0]],
    start=[0, 0],
    goal=[5, 2],
    effort_limit=[[-np.inf, np.inf]],
    duration_s=2.0,
    running_cost=lambda x, u, p, t: 0.5 * u[0] ** 2,
)
BOTH_ENDS = OdeProblem(
    name="a cost and a row of both ends and the duration",
    rate=lambda x, u, p, t: [x[1], u[0]],
    start=[np.nan, 0],
    goal=[np.nan, 0],
    effort_limit=[[-5, 5]],
    duration_s=(0.5, 3),
    running_cost=lambda x, u, p, t: u[0] ** 2,
    final_cost=lambda x0, xT, T, p: 100 * (xT[0] - x0[0] - 1) ** 2 + T + x0[0] ** 2,
    ends=lambda x0, xT, T, p: [xT[0] + x0[0]],
    ends_limit=[[1, 1]],
)
RETURNING = OdeProblem(
    name="states that return, and time in the cost",
    rate=lambda x, u, p, t: [x[1], u[0] - x[0]],
    start=[np.nan, np.nan],
    goal=[np.nan, np.nan],
    returns=[0, 1],
    effort_limit=[[-5, 5]],
    duration_s=2.0,
    running_cost=lambda x, u, p, t: u[0] ** 2 + (x[0] - ca.sin(np.pi * t)) ** 2,
)


def by(solver: SolverSettings, problem: PlanningProblem) -> PlanningProblem:
    return replace(problem, solver=replace(solver, compile=problem.solver.compile))


def transcribed(problem: PlanningProblem, intervals: int = 20, segments: int = 1) -> Transcribed:
    """Return the program of a problem on a small mesh."""
    guess = first_guess(problem, start_pose_of(problem))
    durations = guess.duration_s * np.array([1.0] if segments == 1 else [0.4, 0.6])
    mesh = uniform(intervals) if segments == 1 else segmented(durations, intervals)
    return transcribe(problem, guess, mesh, durations)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "overrides", "same"),
    [
        ("knee-reach", (), SAME_ANSWER),
        ("knee-sprint", (), SAME_ANSWER),
        ("knee-sine-shank", ("motion.kind=periodic",), SAME_WITHOUT_SMOOTHING),
        ("knee-reach", ("motion.kind=periodic", "motion.duration_s=0.4"), SAME_ANSWER),
    ],
    ids=("least effort", "least time, cuts at switches", "periodic without jumps", "periodic between poses"),
)
def test_a_mechanisms_plan_is_ipopts_and_certified(name, overrides, same):
    expected = planned(name, *overrides).require()
    plan = plan_motion(by(FATROP, expected.problem)).require()
    assert plan.objective == pytest.approx(expected.objective, rel=same)
    assert plan.certificate.passed
    assert plan.certificate.effort_excess == 0


@pytest.mark.slow
@pytest.mark.parametrize("problem", [DOUBLE_INTEGRATOR, KIRK, BOTH_ENDS, RETURNING], ids=lambda problem: problem.name)
def test_a_differential_equations_answer_is_ipopts_and_certified(problem):
    expected = plan_ode(problem).require()
    plan = plan_ode(replace(problem, solver=FATROP)).require()
    assert plan.objective == pytest.approx(expected.objective, rel=SAME_ANSWER)
    assert plan.certificate.passed


@pytest.mark.slow
def test_the_double_integrators_least_time_is_two():
    plan = plan_ode(replace(DOUBLE_INTEGRATOR, solver=FATROP)).require()
    assert plan.objective == pytest.approx(2.0, rel=CLOSED_FORM)


@pytest.mark.slow
@pytest.mark.parametrize("segments", [1, 2])
def test_every_unknown_and_bound_of_the_program_is_ipopts(segments):
    program = transcribed(problem_of("knee-sprint", "mesh.intervals=20"), segments=segments)
    expected, found = solve(program, IPOPT), solve(program, FATROP)
    assert expected.converged
    assert found.converged
    assert found.objective == pytest.approx(expected.objective, rel=SAME_ANSWER)
    assert np.all(found.x >= program.lower)
    assert np.all(found.x <= program.upper)
    free = program.lower < program.upper
    room = np.minimum(found.x - program.lower, program.upper - found.x)[free]
    assert room.min() < BINDS


@pytest.mark.slow
def test_the_least_effort_of_a_motion_too_short_is_ipopts():
    problem = problem_of("knee-reach", "motion.duration_s=0.11")
    guess = first_guess(problem, start_pose_of(problem))
    program = transcribe(problem, guess, uniform(20), np.array([guess.duration_s]), least_limit=True)
    expected, found = solve(program, IPOPT), solve(program, FATROP)
    assert expected.objective > 1.1
    assert found.objective == pytest.approx(expected.objective, rel=SAME_ANSWER)


@pytest.mark.slow
def test_a_built_program_is_solved_again_with_new_numbers():
    problem = problem_of("knee-reach")
    goal = np.radians([50.0])
    changed = replace(problem, motion=replace(problem.motion, goal=goal))
    planner = Planner()
    planner.plan(by(FATROP, problem)).require()
    again = planner.plan(by(FATROP, changed)).require()
    assert again.history[0].what == "solved again"
    assert again.objective == pytest.approx(plan_motion(changed).require().objective, rel=SAME_ANSWER)


@pytest.mark.parametrize("settings", [IPOPT, FATROP], ids=lambda settings: settings.name)
@pytest.mark.parametrize(
    "rate",
    [lambda x, u, p, t: [x[1], u[0] + ca.sqrt(-1 - x[0] ** 2)], lambda x, u, p, t: [x[1], u[0] + ca.log(0.5 - x[0])]],
    ids=["everywhere", "beyond a state"],
)
def test_dynamics_that_give_no_number_end_in_a_status_and_silence(rate, settings, capfd):
    problem = OdeProblem(
        name="not a number",
        rate=rate,
        start=[0, 0],
        goal=[1, 0],
        effort_limit=[[-10, 10]],
        duration_s=3.0,
        running_cost=lambda x, u, p, t: u[0] ** 2,
        solver=settings,
    )
    plan = plan_ode(problem)
    assert plan.status == "failed"
    assert "NaN" in plan.message
    assert plan.history[-1].solver_status == INVALID
    said = capfd.readouterr()
    assert said.out == ""
    assert said.err == ""


@pytest.mark.slow
@pytest.mark.parametrize("settings", [IPOPT, FATROP], ids=lambda settings: settings.name)
def test_a_solver_that_runs_out_of_time_says_so(settings):
    solution = solve(transcribed(problem_of("knee-reach", "solver.compile=never")), replace(settings, max_time_s=1e-6))
    assert not solution.converged
    assert solution.status == OUT_OF_TIME


def test_a_solver_that_runs_out_of_iterations_has_no_answer():
    solution = solve(transcribed(problem_of("knee-reach")), replace(FATROP, max_iterations=2))
    assert not solution.converged


@pytest.mark.parametrize("settings", [IPOPT, FATROP], ids=lambda settings: settings.name)
def test_bounds_that_contradict_each_other_end_in_a_status(settings):
    program = transcribed(problem_of("knee-reach"))
    lower = np.array(program.lower)
    lower[program.program.layout.effort()[0]] = 2 * program.upper[program.program.layout.effort()[0]]
    solution = solve(replace(program, lower=lower), settings)
    assert not solution.converged


def test_an_unknown_solver_is_refused_in_one_line():
    with pytest.raises(ProblemError, match=r"unknown solver\.name 'snopt' \(did you mean 'ipopt'\?\); legal: ipopt, fatrop"):
        solve(transcribed(problem_of("knee-reach")), SolverSettings(name="snopt"))
