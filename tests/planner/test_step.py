"""Newton steps from the last plan: what they say is left is more than is left; limits that come to bind are found."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.models.errors import ProblemError
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.closed_chain.transcribe import transcribe
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search.replan import Replanner, motion_step
from linkplan.planner.solvers.newton import NewtonStep, Optimum
from linkplan.planner.transcription.mesh import uniform
from tests.support.tolerances_planner import SOLVERS_OWN_EFFORT, SOLVERS_OWN_POSITION


def with_goal(problem: Problem, degrees: float) -> Problem:
    return replace(problem, motion=replace(problem.motion, goal=np.radians([degrees])))


@pytest.fixture(scope="module")
def problem():
    return load_problem("knee-reach")


def prepared(problem: Problem) -> Replanner:
    planner = Replanner()
    planner.plan(problem)
    return planner


def errors(step, solution):
    """Return how far a step's positions at nodes and efforts are from a converged solve's on the same mesh."""
    from linkplan.planner.closed_chain.transcribe import trajectory_of

    exact = trajectory_of(solution.transcribed, solution.x, np.full((1, 2), [-np.inf, np.inf]))
    own = step.trajectory
    return np.abs(own.position[0] - exact.position[0]).max(), np.abs(own.effort - exact.effort).max()


@pytest.mark.parametrize("goal", [56.2, 55.0, 52.0, 58.0])
def test_the_bound_holds_against_the_converged_answer(problem, goal):
    changed = with_goal(problem, goal)
    step, exact = prepared(problem).step(changed), prepared(problem).solve_again(changed)
    position, effort = errors(step, exact)
    assert step.settled
    assert position <= step.position_bound_rad[0] + SOLVERS_OWN_POSITION
    assert effort <= step.effort_bound[0] + SOLVERS_OWN_EFFORT
    assert step.effort_bound[0] < 0.05  # of 86 N.m: it says something


def test_a_longer_way_leaves_more(problem):
    near, far = (prepared(problem).step(with_goal(problem, goal)) for goal in (56.0, 53.0))
    assert far.effort_bound[0] > 100 * near.effort_bound[0]


def test_a_limit_that_comes_to_bind_is_kept_exactly(problem):
    free = prepared(problem).step(with_goal(problem, 56.0))
    assert np.abs(free.trajectory.effort).max() > 85.0
    limits = replace(problem.limits, effort=np.array([[-80.0, 80.0]]))
    changed = replace(problem, limits=limits)
    step, exact = prepared(problem).step(changed), prepared(problem).solve_again(changed)
    assert step.settled
    assert np.abs(step.trajectory.effort).max() == pytest.approx(80.0, rel=1e-12)
    assert errors(step, exact)[1] <= step.effort_bound[0] + SOLVERS_OWN_EFFORT


def test_a_changed_payload_is_numbers(problem):
    changed = load_problem("knee-reach", ["mechanism.payload.mass_kg=3.9"])
    step, exact = prepared(problem).step(changed), prepared(problem).solve_again(changed)
    assert step.settled
    assert errors(step, exact)[1] <= step.effort_bound[0] + SOLVERS_OWN_EFFORT
    assert np.abs(step.trajectory.effort - prepared(problem).step(problem).trajectory.effort).max() > 0.1


def test_steps_go_on_from_one_another(problem):
    planner = prepared(problem)
    for goal in np.linspace(56.0, 46.0, 21):
        step = planner.step(with_goal(problem, goal))
        assert step.settled
    position, effort = errors(step, prepared(problem).solve_again(with_goal(problem, 46.0)))
    assert position <= step.position_bound_rad[0] + SOLVERS_OWN_POSITION
    assert effort <= step.effort_bound[0] + SOLVERS_OWN_EFFORT


def test_a_step_too_far_says_so_and_does_not_spoil_the_next(problem):
    planner = prepared(problem)
    far = planner.step(with_goal(problem, 10.0))
    assert not far.settled
    assert np.all(np.isinf(far.effort_bound))
    near = planner.step(with_goal(problem, 56.0))
    assert near.effort_bound[0] < 1e-3


def test_where_there_is_no_plan_of_its_structure_there_is_no_step(problem):
    assert Replanner().step(problem) is None
    assert prepared(problem).step(load_problem("knee-reach", ["mesh.intervals=30"])) is None


def test_a_goal_out_of_reach_is_refused(problem):
    with pytest.raises(ProblemError, match="reach"):
        prepared(problem).step(with_goal(problem, 170.0))


def test_a_plan_after_a_step_is_certified(problem):
    planner = prepared(problem)
    planner.step(with_goal(problem, 55.5))
    assert planner.plan(with_goal(problem, 55.0)).status == "optimal"


def test_the_bounds_are_the_error_of_an_unknown_in_its_unit(problem):
    numbered = transcribe(problem, first_guess(problem, problem.start_pose()), uniform(8), np.array([0.16]))
    left = 1e-4
    begin = numbered.start

    def at(x: np.ndarray):
        optimum = Optimum(x=x, rows=np.zeros(0), bounds=np.zeros(0))
        return motion_step(problem, numbered, NewtonStep(optimum=optimum, error_bound=left, violation=0.0, steps=1), 0.0)

    step, moved = at(begin), at(begin + left)
    change = np.abs(moved.trajectory.effort - step.trajectory.effort).max()
    assert change == pytest.approx(step.effort_bound[0], rel=1e-6)
    assert np.all(step.position_bound_rad > 0)
