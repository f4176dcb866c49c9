"""Limits on the rates of efforts: drives begin and end with the efforts that hold the motion at rest."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.controllers.imperfections.plant import held_before
from linkplan.controllers.rollout import ControlLoop
from linkplan.models.errors import ProblemError
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.problem.problem import Problem
from linkplan.planner.proof.prove import prove
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.trajectory import Trajectory
from linkplan.studies.compare.compare import control_loop, tracking_reference
from tests.support.bodies import cart

WAY, RATE, MASS = 0.3, 60.0, 2.0
# A cubic course of acceleration from rest to rest, with a jerk R / m of either sign.
LEAST = (32 * WAY * MASS / RATE) ** (1 / 3)
# Two slides, each with its motor.
GANTRY = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="x" type="slide" axis="1 0 0"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><body><joint name="y" type="slide" axis="0 1 0"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></body></worldbody>
<actuator><motor name="mx" joint="x" ctrlrange="-40 40"/><motor name="my" joint="y" ctrlrange="-2 2"/></actuator></mujoco>"""
# Two links under gravity, coupled by their inertia.
ARM = """<mujoco><option gravity="0 0 -9.81"/><worldbody><body><joint name="a" axis="0 -1 0"/>
<inertial pos="0.25 0 0" mass="2" diaginertia="0.05 0.05 0.05"/><body pos="0.5 0 0"><joint name="b" axis="0 -1 0"/>
<inertial pos="0.2 0 0" mass="1" diaginertia="0.02 0.02 0.02"/></body></body></worldbody><actuator>
<motor name="ma" joint="a" ctrlrange="-40 40"/><motor name="mb" joint="b" ctrlrange="-{most} {most}"/></actuator></mujoco>"""


def reach(**limits) -> Problem:
    limits = {"effort": {"push": [-40.0, 40.0]}, "effort_rate": {"push": RATE}} | limits
    return Problem.reach(cart(), start_m={"x": 0.0}, goal_m={"x": WAY}, minimize="time", limits=limits)


def test_a_drive_at_rest_begins_and_ends_with_the_effort_that_holds_it():
    plan = plan_motion(reach())
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(LEAST, rel=1e-6)
    np.testing.assert_allclose(plan.trajectory.effort_at(np.array([0.0, plan.objective])), 0.0, atol=1e-6)


# A lift of 2 kg with two motors: the small one holds at most 5 N of 19.62 N.
LIFT = """<mujoco><option gravity="0 0 -9.81"/><worldbody><body><joint name="z" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/></body></worldbody><actuator>
<motor name="big" joint="z" ctrlrange="-60 60"/><motor name="small" joint="z" ctrlrange="-5 5"/></actuator></mujoco>"""


def gantry(y_m: float, **limits) -> Problem:
    limits = {"effort_rate": {"mx": RATE}} | limits
    return Problem.reach(GANTRY, start_m={"x": 0.0, "y": 0.0}, goal_m={"x": WAY, "y": y_m}, minimize="time", limits=limits)


@pytest.mark.parametrize(("y_m", "least"), [(0.1, LEAST), (0.5, 1.0)])
def test_of_two_motors_the_one_with_a_limited_rate_begins_at_rest_and_the_other_jumps(y_m, least):
    """The slower axis decides: 0.1 m of y take less time than 0.3 m of x, and 0.5 m take 2 sqrt(0.5 m * 1 kg / 2 N)."""
    plan = plan_motion(gantry(y_m))
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(least, rel=1e-7)
    ends = plan.trajectory.effort_at(np.array([0.0, plan.objective]))
    np.testing.assert_allclose(ends[:, 0], 0.0, atol=1e-6)
    assert ends[0, 1] > 1.0
    assert ends[1, 1] < -1.0
    assert plan.prove(existence=False).complete


def arm(most: float) -> Problem:
    ends = {"start_deg": {"a": 0.0, "b": 0.0}, "goal_deg": {"a": 50.0, "b": 40.0}}
    return Problem.reach(ARM.format(most=most), **ends, minimize="time", limits={"effort_rate": {"mb": 30.0}})


def test_an_effort_with_a_limited_rate_holds_a_coupled_arm_against_its_weight():
    plan = plan_motion(arm(most=12.0))
    assert plan.status == "optimal", plan.message
    held = 9.81 * np.array([[1.2, 0.2], [np.cos(np.radians(50.0)), 0.0]])
    found = plan.trajectory.effort_at(np.array([0.0, plan.objective]))
    np.testing.assert_allclose(found[:, 1], held[:, 1], atol=1e-5)
    assert np.all(np.abs(found - held)[:, 0] > 1.0)


def open_goal(text: str, **more) -> Problem:
    """Return the problem of an arm whose tip goes to x = 0.4 m, with its height open."""
    text = text.replace('<inertial pos="0.2 0 0"', '<site name="tip" pos="0.4 0 0"/><inertial pos="0.2 0 0"')
    ends = {"start_deg": {"a": 0.0, "b": 40.0}, "goal_at": {"tip": {"x": 0.4}}, "duration_s": 0.4}
    return Problem.reach(text, **ends, minimize="effort", limits={"effort_rate": {"mb": 40.0}}, **more)


def test_an_effort_with_a_limited_rate_holds_a_goal_whose_pose_is_open():
    plan = plan_motion(open_goal(ARM.format(most=12.0)))
    assert plan.status == "optimal", plan.message
    end = np.array([plan.trajectory.duration_s])
    a, b = plan.trajectory.position_at(end)[0]
    outer = 9.81 * 0.2 * np.cos(a + b)
    effort = plan.trajectory.effort_at(end)[0]
    assert effort[1] == pytest.approx(outer, abs=1e-5)
    assert abs(effort[0] - (9.81 * np.cos(a) + outer)) > 1.0
    assert plan.prove(existence=False).complete


def test_motors_that_do_not_determine_what_holds_an_open_goal_are_refused():
    third = '<motor name="mc" joint="a" ctrlrange="-9 9"/></actuator>'
    for text, more in ((ARM.replace("</actuator>", third), {}), (ARM, {"mesh": {"scheme": "gauss-3"}})):
        with pytest.raises(ProblemError, match="needs a goal of every independent joint"):
            open_goal(text.format(most=12.0), **more)


def test_a_motor_with_a_limited_rate_that_cannot_hold_its_joint_has_no_motion_from_rest():
    plan = plan_motion(arm(most=1.0))
    assert plan.status == "infeasible"
    assert "cannot hold the start at rest: their limits lack 0.962 N.m on joint b" in plan.message, plan.message


def lift() -> Problem:
    limits = {"effort_rate": {"big": 100.0}}
    return Problem.reach(LIFT, start_m={"z": 0.0}, goal_m={"z": WAY}, minimize="time", limits=limits)


def way_of_lift(half: float) -> float:
    """Return the way [m] in half the time: 10 N at first, which rise and fall by 100 N/s to 5 N at the middle."""
    rise = (half - 0.05) / 2
    fall = half - rise
    ramps = half * rise**2 / 2 - rise**3 / 3 + rise * fall**2 - (rise + fall) * fall**2 / 2 + fall**3 / 3
    return (10.0 * half**2 / 2 + 100.0 * ramps) / MASS


def test_of_two_motors_on_a_joint_the_one_with_a_limited_rate_holds_what_the_other_cannot():
    plan = plan_motion(lift())
    assert plan.status == "optimal", plan.message
    assert way_of_lift(plan.objective / 2) == pytest.approx(WAY / 2, rel=5e-4)  # 1e-4 of the time
    ends = plan.trajectory.effort_at(np.array([0.0, plan.objective]))
    np.testing.assert_allclose(ends, [[24.62, 5.0], [14.62, -5.0]], atol=1e-6)
    assert plan.prove(existence=False).complete
    held = held_before(plan.problem.mechanism, tracking_reference(plan), control_loop(plan.problem))
    np.testing.assert_allclose(held, [24.62, -5.0], atol=0.2)  # the reference begins with the mean of a period
    assert held.sum() == pytest.approx(9.81 * MASS)


def test_an_initial_effort_of_one_motor_leaves_the_other_to_hold_the_start():
    plan = plan_motion(gantry(0.1, effort_rate={"mx": RATE, "my": 100.0}, initial_effort={"my": 1.0}))
    assert plan.objective == pytest.approx(LEAST, rel=1e-7)
    np.testing.assert_allclose(plan.trajectory.effort_at(np.zeros(1))[0], [0.0, 1.0], atol=1e-6)
    other = gantry(0.1, effort_rate={"mx": 100.0, "my": RATE})
    refuted = [one.name for one in prove(other, plan.trajectory, existence=False).of("refuted")]
    assert "efforts hold the start at rest" in refuted
    assert not certify(other, plan.trajectory).passed


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
    """With 10 N from the start the least time is shorter; the effort ends at rest at 0.

    It rises for t1, falls for t2 and rises for t3 at its largest rate: u, v and x - 0.3 m end at 0 after 0.596348372 s.
    """
    plan = plan_motion(reach(initial_effort={"push": 10.0}))
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(0.5963483720545, rel=1e-7)
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
