"""Limits on pin force of several freedoms that nodes alone leave overrun: kept at every instant by rows on coefficients."""

import numpy as np
import pytest

from linkplan.models.poses.assembly import follow
from linkplan.planner.limits.joints import ClosureForceLimit
from linkplan.planner.limits.samples import closure_forces
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.marking import Tightening, evened
from linkplan.planner.search.planning import plan_motion
from tests.support.five_bar_reach import five_bar_reach

# A force may exceed its limit by what rounding makes of it, as a share.
ROUNDING = 1e-6
# A duration [s] near the least within 13 N, 0.382 s, which takes minutes to find. With rows at nodes alone one of 0.594 s
# was the quickest that passed. How far below the rating the largest force may stay.
DURATION_S, CLOSE = 0.42, 1e-4


def five_bar(newton: float, **motion) -> dict:
    return five_bar_reach({"closure_force": {"E2": newton}}, **motion)


@pytest.mark.slow
def test_a_pin_of_a_five_bar_is_kept_within_its_rating_at_every_instant_of_a_quick_motion():
    plan = plan_motion(Problem.from_tables("five-bar", five_bar(13.0, duration_s=DURATION_S)))
    assert plan.status == "optimal", plan.message
    motion, mechanism = plan.trajectory, plan.problem.mechanism
    times = np.linspace(0.0, motion.duration_s, 4001)
    s, v, a, u = (of(times) for of in (motion.position_at, motion.velocity_at, motion.acceleration_at, motion.effort_at))
    forces = closure_forces(plan.problem, follow(mechanism, s, motion.start_pose), v, a, u)
    assert forces.max() <= (1 + ROUNDING) * 13.0
    assert forces.max() >= (1 - CLOSE) * 13.0  # it binds


def test_a_pin_s_force_takes_an_unknown_for_each_of_its_rows():
    problem = Problem.from_tables("five-bar", five_bar(13.0))
    (limit,), (at_nodes,) = (ClosureForceLimit.of(problem, enclosed=enclosed) for enclosed in (True, False))
    size = problem.mechanism.closure_slice(limit.item)
    assert (limit.rows.n_unknowns, limit.rows.node) == (size.stop - size.start, None)
    assert at_nodes.rows.node is not None
    assert (at_nodes.rows.n_unknowns, at_nodes.item) == (0, limit.item)


def test_little_tightenings_are_the_same_all_along_and_large_ones_where_they_were():
    breaks = np.linspace(0.0, 1.0, 4)
    little, large = (
        Tightening(what="closure_force", item=0, breaks=breaks, share=np.array([0.0, share, 0.0])) for share in (1e-6, 1e-2)
    )
    one, other = evened((little, large))
    assert np.array_equal(one.share, np.full(3, 1e-6))
    assert np.array_equal(other.share, large.share)
