"""Limits on the pose that a motion touches in an instant: passed there, they cost no more than they must."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.models.poses.along import sampled
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.closed_chain.guess import motion_of, poses_along
from linkplan.planner.files.problem_file import problem_from_tables
from linkplan.planner.plan import Plan
from linkplan.planner.planning import RUNGS, plan_motion
from linkplan.planner.problem.motion import Waypoint
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.search.touches import through_touches, touches
from tests.support.fourbar_problems import random_case

# Least effort in five times the shortest duration: it gathers way towards a dead centre, and a margin to that stops it.
SEED, NUMBER, MARGIN = 1, 360, 0.5
# The ladder without the rung.
ALONE = tuple(rung for rung in RUNGS if rung.climb is not through_touches)
# Of the objective: what plans agree to, what the default mesh lost beside the margin and beside a range.
AGREE, LOST = 1e-9, 1e-5


def free() -> PlanningProblem:
    return problem_from_tables("beside a dead centre", random_case(SEED, NUMBER).tables)


def within_margin() -> PlanningProblem:
    problem = free()
    return replace(problem, limits=replace(problem.limits, singular_margin=MARGIN))


def ratio_at_turn(problem: PlanningProblem, plan: Plan) -> float:
    """Return |det J_z| as a share of home's where a plan has gone furthest back."""
    time = plan.trajectory.breaks_s
    at = time[[int(np.argmin(plan.trajectory.position_at(time)[:, 0]))]]
    singularity = problem.mechanism.dynamics.singularity
    pose = poses_along(problem.mechanism, motion_of(plan.trajectory), np.append(0.0, at))
    return abs(float(sampled(singularity, pose)[-1, 0, 0] / float(singularity(problem.mechanism.home))))


@pytest.mark.slow
def test_a_margin_to_singular_poses_a_range_and_a_waypoint_at_rest_there_come_to_the_same():
    problem = free()
    within = within_margin()
    plan = plan_motion(within)
    assert plan.status == "optimal", plan.message
    assert certify(within, plan.trajectory).passed
    assert ratio_at_turn(within, plan) == pytest.approx(MARGIN, rel=1e-8)
    place = float(plan.trajectory.position.min())
    position = np.array(problem.limits.position)
    position[problem.mechanism.independent[0], 0] = place
    ranged = plan_motion(replace(problem, limits=replace(problem.limits, position=position)))
    assert ranged.objective == pytest.approx(plan.objective, rel=AGREE)
    there = (Waypoint(position=[place], speed=[0.0]),)
    passed = plan_motion(replace(problem, motion=replace(problem.motion, waypoints=there)))
    assert passed.objective == pytest.approx(plan.objective, rel=1e-7)


@pytest.mark.slow
def test_the_mesh_alone_pays_for_the_room_it_keeps():
    plan, alone = plan_motion(within_margin()), plan_motion(within_margin(), rungs=ALONE)
    assert alone.passed
    assert alone.objective > (1 + LOST) * plan.objective


@pytest.mark.slow
def test_a_motion_that_turns_clear_of_every_limit_touches_none():
    problem = free()
    further = replace(problem, limits=replace(problem.limits, singular_margin=0.05))
    plan = plan_motion(within_margin(), rungs=ALONE)
    assert len(touches(within_margin(), plan.trajectory)) == 1
    assert touches(further, plan.trajectory) == []
