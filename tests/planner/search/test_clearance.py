"""Next to singular poses: motions kept clear where none is found without, known switches where a free solve is lost."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from linkplan.models.poses.along import sampled
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.closed_chain.guess import first_guess, motion_of, poses_along
from linkplan.planner.files.problem_file import problem_from_tables
from linkplan.planner.plan import Plan
from linkplan.planner.planning import plan_motion
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.search.attempts import plan_from
from linkplan.planner.search.ladder import HURRIED, PATIENT, Search
from linkplan.planner.search.margin_continuation import from_margins, may_be_kept_clear, nears_singular
from linkplan.planner.search.phase_plane import least_time_guess
from linkplan.planner.search.presolve import start_pose_of
from tests.support.fourbar_problems import random_case
from tests.support.tolerances_planner import PHASE_PLANE_TIME

SEED = 1
# Least effort in five times the shortest duration: the longer, the nearer to the dead centre the motion gathers way.
TO_A_DEAD_CENTRE = 360
# Least time with a range, from next to a singular pose.
THROUGH_THE_MESH = 474


def problem_of(number: int) -> PlanningProblem:
    return problem_from_tables("next to a singular pose", random_case(SEED, number).tables)


def search_for(problem: PlanningProblem) -> Search:
    begun = replace(problem, solver=problem.solver.begun())
    return Search(problem=begun, start_pose=start_pose_of(problem), say=lambda _: None)


@cache
def clear_plan() -> Plan:
    plan = from_margins(search_for(problem_of(TO_A_DEAD_CENTRE)), HURRIED)
    assert plan is not None
    return plan


@pytest.mark.slow
def test_a_motion_kept_clear_keeps_the_problem_that_was_asked_and_says_so():
    plan = clear_plan()
    assert plan.status == "feasible"  # the best of those that keep clear, which nobody asked for
    assert plan.problem.limits.singular_margin == 0.0
    assert certify(plan.problem, plan.trajectory).passed
    assert "kept clear of singular poses by" in plan.message


@pytest.mark.slow
def test_a_motion_kept_clear_stays_on_its_branch_nearer_than_its_ends_are():
    plan = clear_plan()
    singularity = plan.problem.mechanism.dynamics.singularity
    poses = poses_along(plan.problem.mechanism, motion_of(plan.trajectory), np.linspace(0, plan.trajectory.duration_s, 2001))
    share = sampled(singularity, poses)[:, 0, 0] / float(singularity(plan.problem.mechanism.home))
    assert 0 < share.min() < 0.2 * min(share[0], share[-1])
    assert nears_singular(plan.problem, motion_of(plan.trajectory))


@pytest.mark.slow
def test_a_margin_drawn_in_saves_effort():
    problem = problem_of(TO_A_DEAD_CENTRE)
    wide = plan_motion(replace(problem, limits=replace(problem.limits, singular_margin=0.5)))
    assert wide.status == "optimal"
    assert clear_plan().objective < 0.9 * wide.objective


@pytest.mark.slow
def test_a_problem_with_a_margin_of_its_own_keeps_it():
    problem = problem_of(TO_A_DEAD_CENTRE)
    own = replace(problem, limits=replace(problem.limits, singular_margin=0.1))
    assert not may_be_kept_clear(own)
    assert may_be_kept_clear(problem)


def test_a_straight_motion_in_the_open_nears_no_singular_pose():
    problem = problem_of(TO_A_DEAD_CENTRE)
    assert not nears_singular(problem, first_guess(problem, start_pose_of(problem)))


@pytest.mark.slow
def test_known_switches_are_planned_next_to_a_singular_pose():
    """From a smooth path, solvers fly through the mesh: 24 % faster than the least time, and no motion."""
    case, problem = random_case(SEED, THROUGH_THE_MESH), problem_of(THROUGH_THE_MESH)
    quickest = least_time_guess(problem, start_pose_of(problem))
    assert quickest is not None
    plan = plan_from(search_for(problem), PATIENT, "the phase plane", quickest)
    assert plan is not None
    assert plan.status == "optimal"
    assert abs(plan.objective / case.duration - 1) < PHASE_PLANE_TIME
