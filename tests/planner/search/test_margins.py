"""The distance from singular poses in searches, and what forbids the only way."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.limits.joints import RangeLimit, SingularMarginLimit
from linkplan.planner.limits.kinds import limits_of
from linkplan.planner.limits.samples import singularity_ratios
from linkplan.planner.phase_plane.bang_bang_motions import least_time_guess
from linkplan.planner.plan.plan import Plan
from linkplan.planner.plan.verdict import failed
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.attempts import plan_from
from linkplan.planner.search.least_limit import least_limit_of_starts
from linkplan.planner.search.methods import FULL_BUDGET, Search, SearchMethod
from linkplan.planner.search.planning import plan_motion, search_for
from linkplan.planner.search.presolve import ONLY_WAY_SLACK, only_way, pose_beyond
from linkplan.planner.search.starts import at_a_distance, may_near_singular
from tests.bench.contradictions import weak_case
from tests.support.bodies import HINGE, QUARTER_TURN, body_problem
from tests.support.fourbar_problems import random_case
from tests.support.plans import problem_of
from tests.support.tolerances_planner import PHASE_PLANE_TIME


def weak_reach(number: int, duration_s: float | str = 1.0, minimize: str = "effort", margin: float = 0.0) -> Problem:
    """Return the reach of a weak four-bar, within a margin to singular poses."""
    fourbar, start, goal, limit = weak_case(9001, number)
    ends = {"start_deg": {"O": np.degrees(start)}, "goal_deg": {"O": np.degrees(goal)}}
    problem = Problem.reach(fourbar.mjcf(start, limit=limit), **ends, duration_s=duration_s, minimize=minimize)
    return problem.varied(limits=replace(problem.limits, singular_margin=margin))


@pytest.mark.hardest
def test_a_swing_up_to_a_dead_centre_costs_no_more_with_more_time():
    """At 1.01 times the least time of 0.794659 s a motion of 4.2878 was known, and none cheaper at 1.03 times."""
    plan = plan_motion(weak_reach(18, 1.03 * 0.794659))
    assert plan.status == "feasible", plan.message
    assert plan.objective < 4.2878
    assert plan.certificate.singularity_ratio >= 0.02 - 1e-6
    assert "it keeps a distance from singular poses, 0.02 of that at home" in plan.message


def test_a_distance_is_kept_where_loops_may_come_near_a_singular_pose_and_no_margin_is_asked_for():
    assert may_near_singular(search_for(weak_reach(18)))
    assert not may_near_singular(search_for(weak_reach(18, margin=1e-3)))
    # A crank that turns fully, and may pass a nearly singular pose; a motion in 0.1 s is too short for it.
    assert may_near_singular(search_for(weak_reach(0, duration_s=2.0)))
    assert not may_near_singular(search_for(weak_reach(0, duration_s=0.1)))
    without_loops = body_problem(HINGE, QUARTER_TURN + "duration_s = 2.0\n")
    assert search_for(without_loops).quickest is not None
    assert not may_near_singular(search_for(without_loops))


def test_motions_that_miss_do_not_keep_a_search_from_a_distance():
    search = search_for(weak_reach(18))
    missed = Plan(problem=search.problem, verdict=failed("left its branch"))
    search.plans.extend([missed, missed])
    assert not search.starts_are_worth_it
    assert may_near_singular(search)


def test_the_margin_is_kept_by_every_pose_between_start_and_goal():
    seen = []

    def noted(search: Search, _budget: object) -> None:
        seen.append(search.problem.limits.singular_margin)

    methods = (SearchMethod(name="noted", run=noted, budget=FULL_BUDGET),)
    far = search_for(weak_reach(18), methods)
    assert at_a_distance(far, FULL_BUDGET) is None
    # The dead centre is at 2.99806 rad.
    motion = replace(far.problem.motion, goal=np.array([2.998]))
    assert at_a_distance(search_for(far.problem.varied(motion=motion), methods), FULL_BUDGET) is None
    assert seen[0] == 0.02
    assert 0.0 < seen[1] < 0.02


@pytest.mark.slow
def test_a_first_motion_that_leaves_the_reach_between_its_nodes_is_no_second_start():
    problem = weak_reach(40, "free", "time", margin=0.02)
    search = search_for(problem)
    least = least_limit_of_starts(problem, search.smooth)
    assert least is None or least.factor > 0.0


SEED = 1
# Least time with a range, from next to a singular pose.
THROUGH_THE_MESH = 474


@pytest.mark.slow
def test_known_switches_are_planned_next_to_a_singular_pose():
    """From a smooth path, solvers fly through the mesh: 24 % faster than the least time, and no motion."""
    case = random_case(SEED, THROUGH_THE_MESH)
    problem = Problem.from_tables("next to a singular pose", case.tables)
    quickest = least_time_guess(problem, problem.start_pose())
    assert quickest is not None
    plan = plan_from(search_for(problem), FULL_BUDGET, "the phase plane", quickest)
    assert plan is not None
    assert plan.status == "optimal"
    assert abs(plan.objective / case.duration - 1) < PHASE_PLANE_TIME


# Shares of the allowance, a millionth, on both sides of it.
WITHIN, BEYOND = 0.5e-6, 2e-6


def limited(**changes) -> Problem:
    problem = problem_of("knee-reach")
    return problem.varied(limits=replace(problem.limits, **changes))


def beyond(problem: Problem) -> str | None:
    limits = [limit for limit in limits_of(problem) if isinstance(limit, RangeLimit | SingularMarginLimit)]
    found = pose_beyond(problem, limits, only_way(problem), None, ONLY_WAY_SLACK)
    return found and found.sentence


@pytest.mark.parametrize(("short", "refused"), [(WITHIN, False), (BEYOND, True)])
def test_a_dependent_joint_beyond_its_range_is_refused(short, refused):
    mechanism = limited().mechanism
    joint = int(mechanism.dependent[0])
    most = only_way(limited())[:, joint].max()
    ranges = np.array(limited().limits.position)
    ranges[joint] = [-np.inf, most - short]
    said = beyond(limited(position=ranges))
    assert (said is not None) == refused
    if said is not None:
        assert f"joint {mechanism.joints[joint].name} stands at" in said


@pytest.mark.parametrize(("more", "refused"), [(-WITHIN, False), (WITHIN, False), (BEYOND, True)])
def test_a_pose_short_of_the_singular_margin_is_refused(more, refused):
    least = singularity_ratios(limited().mechanism, only_way(limited())).min()
    assert 0.0 < least < 1.0
    said = beyond(limited(singular_margin=least * (1 + more)))
    assert (said is not None) == refused
    if said is not None:
        assert "short of its limit" in said
