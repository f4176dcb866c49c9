"""A linkage that swings up to a dead centre has no best motion: within a margin to singular poses it has one."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.ladder import FULL_BUDGET, Search, SearchMethod
from linkplan.planner.search.least_limit import least_limit_of_starts
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.search.starts import at_a_distance, may_near_singular
from tests.bench.contradictions import weak_case


def weak_reach(number: int, duration_s: float | str = 1.0, minimize: str = "effort", margin: float = 0.0) -> Problem:
    """Return the reach of a weak four-bar, within a margin to singular poses."""
    fourbar, start, goal, limit = weak_case(9001, number)
    ends = {"start_deg": {"O": float(np.degrees(start))}, "goal_deg": {"O": float(np.degrees(goal))}}
    tables = {
        "mechanism": {"model": fourbar.mjcf(start, limit=limit)},
        "motion": {"kind": "reach", **ends, "duration_s": duration_s},
        "objective": {"minimize": minimize},
    }
    problem = Problem.from_tables("weak", tables)
    return replace(problem, limits=replace(problem.limits, singular_margin=margin))


# A pendulum on one joint.
SERIAL_REACH = {
    "mechanism": {
        "model": """<mujoco>
            <worldbody><body>
                <joint name="a" axis="0 1 0"/>
                <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02"/>
            </body></worldbody>
            <actuator><motor name="m" joint="a" ctrllimited="true" ctrlrange="-1 1"/></actuator>
        </mujoco>"""
    },
    "motion": {"kind": "reach", "start_deg": {"a": 0.0}, "goal_deg": {"a": 30.0}, "duration_s": 2.0},
    "objective": {"minimize": "effort"},
}


def search_of(problem: Problem) -> Search:
    return Search(problem=problem, start_pose=problem.start_pose())


@pytest.mark.long
def test_a_swing_up_to_a_dead_centre_costs_no_more_with_more_time():
    """At 1.01 times the least time of 0.794659 s a motion of 4.2878 was known, and none cheaper at 1.03 times."""
    plan = plan_motion(weak_reach(18, 1.03 * 0.794659))
    assert plan.status == "feasible", plan.message
    assert plan.objective < 4.2878
    assert plan.certificate.singularity_ratio >= 0.02 - 1e-6
    assert "it keeps a distance from singular poses, 0.02 of that at home" in plan.message


def test_a_distance_is_kept_where_loops_may_come_near_a_singular_pose_and_no_margin_is_asked_for():
    assert may_near_singular(search_of(weak_reach(18)))
    assert not may_near_singular(search_of(weak_reach(18, margin=1e-3)))
    # A crank that turns fully, and may pass a nearly singular pose; a motion in 0.1 s is too short for it.
    assert may_near_singular(search_of(weak_reach(0, duration_s=2.0)))
    assert not may_near_singular(search_of(weak_reach(0, duration_s=0.1)))
    without_loops = Problem.from_tables("serial", SERIAL_REACH)
    assert search_of(without_loops).quickest is not None
    assert not may_near_singular(search_of(without_loops))


def test_motions_that_miss_do_not_keep_a_search_from_a_distance():
    """Both motions from the phase plane had left the branch. The method was not tried; the plan cost 21.6, not 5.43."""
    search = search_of(weak_reach(18))
    missed = Plan(problem=search.problem, status="failed", message="left its branch")
    search.plans.extend([missed, missed])
    assert not search.starts_are_worth_it
    assert may_near_singular(search)


def test_the_margin_is_kept_by_every_pose_between_start_and_goal():
    seen = []

    def noted(search: Search, _budget: object) -> None:
        seen.append(search.problem.limits.singular_margin)

    methods = (SearchMethod(name="noted", run=noted, budget=FULL_BUDGET),)
    far = search_of(weak_reach(18))
    assert at_a_distance(far, FULL_BUDGET, methods) is None
    # The dead centre is at 2.99806 rad.
    motion = replace(far.problem.motion, goal=np.array([2.998]))
    assert at_a_distance(search_of(replace(far.problem, motion=motion)), FULL_BUDGET, methods) is None
    assert seen[0] == 0.02
    assert 0.0 < seen[1] < 0.02


@pytest.mark.slow
def test_a_first_motion_that_leaves_the_reach_between_its_nodes_is_no_second_start():
    problem = weak_reach(40, "free", "time", margin=0.02)
    search = search_of(problem)
    least = least_limit_of_starts(problem, search.smooth)
    assert least is None or least.factor > 0.0
