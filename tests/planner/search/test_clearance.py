"""Next to singular poses: which motions near one, and known switches where a free solve is lost."""

from dataclasses import replace

import pytest

from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.phase_plane.bang_bang_motions import least_time_guess
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.attempts import plan_from
from linkplan.planner.search.continuations import nears_singular
from linkplan.planner.search.ladder import FULL_BUDGET, Search
from tests.support.fourbar_problems import random_case
from tests.support.tolerances_planner import PHASE_PLANE_TIME

SEED = 1
# Least effort in five times the shortest duration: the longer, the nearer to the dead centre the motion gathers way.
TO_A_DEAD_CENTRE = 360
# Least time with a range, from next to a singular pose.
THROUGH_THE_MESH = 474


def problem_of(number: int) -> Problem:
    return Problem.from_tables("next to a singular pose", random_case(SEED, number).tables)


def search_for(problem: Problem) -> Search:
    begun = replace(problem, solver=problem.solver.begun())
    return Search(problem=begun, start_pose=problem.start_pose())


def test_a_straight_motion_in_the_open_nears_no_singular_pose():
    problem = problem_of(TO_A_DEAD_CENTRE)
    assert not nears_singular(problem, first_guess(problem, problem.start_pose()))


@pytest.mark.slow
def test_known_switches_are_planned_next_to_a_singular_pose():
    """From a smooth path, solvers fly through the mesh: 24 % faster than the least time, and no motion."""
    case, problem = random_case(SEED, THROUGH_THE_MESH), problem_of(THROUGH_THE_MESH)
    quickest = least_time_guess(problem, problem.start_pose())
    assert quickest is not None
    plan = plan_from(search_for(problem), FULL_BUDGET, "the phase plane", quickest)
    assert plan is not None
    assert plan.status == "optimal"
    assert abs(plan.objective / case.duration - 1) < PHASE_PLANE_TIME
