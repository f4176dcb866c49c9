"""Limits on the rates of efforts: drives begin and end with the efforts that hold the motion at rest."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.controllers.rollout import ControlLoop
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.problem.problem import Problem
from linkplan.planner.proof.prove import prove
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.trajectory import Trajectory
from tests.support.bodies import cart

WAY, RATE, MASS = 0.3, 60.0, 2.0
# A cubic course of acceleration from rest to rest, with a jerk R / m of either sign.
LEAST = (32 * WAY * MASS / RATE) ** (1 / 3)


def reach(**limits) -> Problem:
    limits = {"effort": {"push": [-40.0, 40.0]}, "effort_rate": {"push": RATE}} | limits
    return Problem.reach(cart(), start_m={"x": 0.0}, goal_m={"x": WAY}, minimize="time", limits=limits)


def test_a_drive_at_rest_begins_and_ends_with_the_effort_that_holds_it():
    plan = plan_motion(reach())
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(LEAST, rel=1e-6)
    np.testing.assert_allclose(plan.trajectory.effort_at(np.array([0.0, plan.objective])), 0.0, atol=1e-6)


def falling_effort(problem: Problem) -> Trajectory:
    """Return the motion under an effort that falls at its largest rate: it begins with a jump from 0 to R T / 2."""
    duration = (12 * WAY * MASS / RATE) ** (1 / 3)
    first = RATE * duration / 2
    position = WAY * np.array([0.0, 0.0, 1.0, 1.0])
    velocity = WAY / duration * np.array([0.0, 3.0, 0.0])
    effort = np.array([first, -first])
    parts = (values[:, None, None] for values in (position, velocity, effort))
    given = zip(("position", "velocity", "effort"), parts, strict=True)
    return Trajectory(breaks_s=np.array([0.0, duration]), start_pose=problem.start_pose(), periodic=False, **dict(given))


def test_a_jump_of_the_effort_from_rest_overruns_its_rate():
    problem = reach()
    failures = certify(problem, falling_effort(problem)).failures
    assert any("effort rate" in failure for failure in failures), failures
    unlimited = problem.varied(limits=replace(problem.limits, effort_rate=np.array([[-np.inf, np.inf]])))
    assert certify(unlimited, falling_effort(problem)).passed


def test_an_initial_effort_replaces_the_one_that_holds_the_start():
    """With 10 N from the start the least time is shorter; the effort ends at rest at 0."""
    plan = plan_motion(reach(initial_effort={"push": 10.0}))
    assert plan.status == "optimal", plan.message
    assert plan.objective < 0.95 * LEAST
    np.testing.assert_allclose(plan.trajectory.effort_at(np.array([0.0, plan.objective]))[:, 0], [10.0, 0.0], atol=1e-6)
    assert plan.prove(existence=False).complete
    other = reach(initial_effort={"push": 9.9})
    refuted = [one.name for one in prove(other, plan.trajectory, existence=False).of("refuted")]
    assert refuted == ["the effort of push begins at limits.initial_effort"]
    assert not certify(other, plan.trajectory).passed


def test_commands_that_the_rate_limit_does_not_allow_count_as_saturated():
    loop = ControlLoop(effort_limit=np.array([[-10.0, 10.0]]), rate_limit=np.array([5.0]))
    commanded = np.array([[0.0], [0.5], [3.0], [3.0], [11.0]])
    np.testing.assert_array_equal(loop.saturates(commanded, 0.1, np.zeros(1)), [False, False, True, True, True])
    assert loop.saturates(commanded, 0.1, np.full(1, 4.0))[0]
