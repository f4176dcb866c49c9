"""Legs along limits on power as a motion of their own: its certificate passes, and it is as quick as the exact legs are."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.certificate.certificate import certify
from linkplan.planner.phase_plane.legs_motion import _inside, legs_motion
from linkplan.planner.problem.motion import Waypoint
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search import starts
from linkplan.planner.search.ladder import Search
from linkplan.planner.search.planning import SEARCH_METHODS, plan_motion
from tests.support.least_time import least_time

# What is left of limits for what polynomials do between their nodes, of the least time; and of the power along its limit.
ROOM = 1e-7
# What the legs' curves over the way differ from the mechanism by, of the largest effort.
SAME_LAW = 1e-7


def within(watts: float):
    return load_problem("knee-sprint", [f"limits.power_w.act_O={watts}"])


def test_its_certificate_passes_and_it_takes_the_least_time():
    problem = within(100.0)
    motion = legs_motion(problem, problem.start_pose())
    certificate = certify(problem, motion)
    assert certificate.passed, certificate.failures
    assert certificate.dynamics_residual < SAME_LAW * np.abs(motion.effort).max()
    assert motion.duration_s == pytest.approx(least_time(problem), rel=ROOM)


def test_power_is_at_its_limit_all_along_but_for_bangs():
    problem = within(10.0)
    motion = legs_motion(problem, problem.start_pose())
    time = motion.dense_times(20)
    effort, power = motion.effort_at(time), motion.effort_at(time) * motion.velocity_at(time)
    spent = np.isclose(np.abs(power), 10.0, rtol=ROOM)
    assert np.all(spent | np.isclose(np.abs(effort), 100.0, rtol=ROOM))
    assert np.mean(spent) > 0.9


def test_a_waypoint_on_the_way_is_passed_at_a_break():
    problem = within(100.0)
    passing = replace(problem, motion=replace(problem.motion, waypoints=(Waypoint(position=[0.0]),)))
    certificate = certify(passing, legs_motion(passing, passing.start_pose()))
    assert certificate.passed, certificate.failures


@pytest.mark.parametrize("place", [-0.8, 0.9])
def test_of_either_leg_a_waypoint_s_instant_is_a_break(place):
    """From -0.86 to 0.98 rad, the legs' switch lies between."""
    problem = within(100.0)
    passing = replace(problem, motion=replace(problem.motion, waypoints=(Waypoint(position=[place]),)))
    motion, straight = (legs_motion(one, one.start_pose()) for one in (passing, problem))
    breaks = motion.position_at(motion.breaks_s)[:, 0]
    assert np.abs(breaks - place).min() < 1e-9
    assert np.abs(straight.position_at(straight.breaks_s)[:, 0] - place).min() > 1e-6
    assert motion.duration_s == pytest.approx(straight.duration_s, rel=ROOM)


def test_limits_inside_are_nearer_to_zero_by_a_share_of_their_own_size():
    np.testing.assert_allclose(_inside(np.array([[-3.0, 5.0]])) - [[-3.0, 5.0]], [[3e-8, -5e-8]], rtol=1e-6)
    np.testing.assert_allclose(_inside(np.array([[1.0, np.inf]])), [[1.0 + 1e-8, np.inf]], rtol=1e-15)
    np.testing.assert_allclose(_inside(np.array([[-np.inf, 2.0]])), [[-np.inf, 2.0 - 2e-8]], rtol=1e-15)


@pytest.mark.slow
def test_a_least_time_is_that_of_the_legs():
    problem = within(10.0)
    plan = plan_motion(problem, methods=SEARCH_METHODS[:1])
    assert plan.status == "optimal", plan.message
    assert plan.solved is None
    assert plan.scheme == f"radau-{len(plan.trajectory.effort)}"  # that of its polynomials, not the problem's
    assert plan.objective == pytest.approx(least_time(problem), rel=ROOM)


@pytest.mark.slow
def test_a_limit_that_the_legs_do_not_know_forbids_them():
    for further, passes in (([], True), (["limits.effort_rate.act_O=1e6"], False)):
        problem = load_problem("knee-sprint", ["limits.power_w.act_O=100", *further])
        search = Search(problem=problem, start_pose=problem.start_pose())
        assert (starts.along_limits(search, SEARCH_METHODS[0].budget) is not None) == passes
