"""Legs along limits on power as a motion of their own: its certificate passes, and it is as quick as the exact legs are."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.models.poses.along import sampled
from linkplan.models.poses.assembly import follow
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.phase_plane.legs_motion import legs_motion
from linkplan.planner.planning import RUNGS, plan_motion
from linkplan.planner.problem.motion import Waypoint
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search import starts
from linkplan.planner.search.ladder import Search
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


@pytest.mark.slow
def test_a_least_time_is_that_of_the_legs():
    problem = within(10.0)
    plan = plan_motion(problem, rungs=RUNGS[:1])
    assert plan.status == "optimal", plan.message
    assert plan.solved is None
    assert plan.scheme == f"radau-{len(plan.trajectory.effort)}"  # that of its polynomials, not the problem's
    assert plan.objective == pytest.approx(least_time(problem), rel=ROOM)


@pytest.mark.slow
def test_a_limit_that_the_legs_do_not_know_forbids_them():
    for share, passes in ((1.01, True), (0.99, False)):
        problem = load_problem("knee-sprint", ["limits.power_w.act_O=100", f"limits.speed_deg_s.A={share * peak_speed()}"])
        search = Search(problem=problem, start_pose=problem.start_pose())
        assert (starts.along_power(search, RUNGS[0].budget) is not None) == passes


def peak_speed() -> float:
    """Return the largest speed of a joint that follows [deg/s]."""
    problem = within(100.0)
    motion = legs_motion(problem, problem.start_pose())
    time = motion.dense_times(8)
    s, v = motion.position_at(time), motion.velocity_at(time)
    joint = [one.name for one in problem.mechanism.joints].index("A")
    ratio = sampled(problem.mechanism.dynamics.velocity_map, follow(problem.mechanism, s, problem.start_pose()))
    return float(np.degrees(np.abs(ratio[:, joint, 0] * v[:, 0]).max()))
