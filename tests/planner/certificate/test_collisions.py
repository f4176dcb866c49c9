"""Collisions along a motion: whether every motion has them, and how they are told."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs
from scipy.optimize import brentq

from linkplan.models.poses.contacts import Contact
from linkplan.planner.certificate import further_checks
from linkplan.planner.certificate.further_checks import contact_notes, surely_collides, unavoidable, with_contacts
from tests.support.bodies import body_plan


def meeting(since: float | None, depth_m: float = 1e-3, home_depth_m: float = 0.0, first: str = "a") -> Contact:
    depths = {"depth_m": depth_m, "home_depth_m": home_depth_m}
    return Contact(geoms=(first, "b"), bodies=("A", "B"), since_s=since, deepest_at_s=since or 0.0, **depths)


# A ball on a hinge of 0.5 m that swings towards a wall, 0.05 m beyond the goal or 0.1 m before it.
SWING = """<mujoco><option gravity="0 0 0"/><worldbody><geom name="wall" type="box" size="0.01 0.2 0.2" pos="{wall} 0 -0.5"/>
<body name="arm"><joint name="J" axis="0 -1 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<geom name="ball" type="sphere" size="0.02" pos="0 0 -0.5"/></body></worldbody>
<actuator><motor name="m" joint="J" ctrlrange="-9 9"/></actuator></mujoco>"""
MOTION = 'kind = "reach"\nstart_deg = { J = -30.0 }\ngoal_deg = { J = 20.0 }\nduration_s = 1.0\n'
GOAL_M = 0.5 * np.sin(np.radians(20.0))


@pytest.fixture(scope="module")
def swing():
    """Return the problem with a wall in the way, or not, and a motion that ignores it."""
    return {
        beyond: body_plan(SWING.format(wall=GOAL_M + 0.03 + beyond), MOTION, "limits.contacts=note")
        for beyond in (0.05, -0.1)
    }


@pytest.mark.parametrize(("start", "goal"), [(-10.0, 10.0), (10.0, -10.0)])
@pytest.mark.parametrize(("pose", "expected"), [(-10.1, False), (-9.9, True), (0.0, True), (9.9, True), (10.1, False)])
def test_a_collision_is_unavoidable_at_a_pose_between_start_and_goal(swing, start, goal, pose, expected):
    """The swing from -30 to 20 deg stands for a motion between -10 and 10 deg that goes beyond both ends."""
    plan = swing[0.05]
    motion = replace(plan.problem.motion, start=np.radians([start]), goal=np.radians([goal]))
    problem, trajectory = replace(plan.problem, contacts="refuse", motion=motion), plan.trajectory
    since = brentq(lambda t: float(trajectory.position_at(np.array([t]))[0, 0]) - np.radians(pose), 0, trajectory.duration_s)
    certificate = structs.replace(plan.certificate, contacts=(meeting(since),))
    assert unavoidable(problem, trajectory, certificate) is expected
    assert not unavoidable(replace(problem, contacts="note"), trajectory, certificate)
    assert not unavoidable(problem, trajectory, structs.replace(certificate, contacts=(meeting(None),)))


@pytest.mark.parametrize("beyond", [0.05, -0.1])
def test_a_collision_is_found_where_the_ball_reaches_the_wall_and_refused_unless_contacts_are_noted(swing, beyond):
    plan = swing[beyond]
    certificate = structs.replace(plan.certificate, contacts=())
    noted = with_contacts(plan.problem, plan.trajectory, certificate)
    refused = with_contacts(replace(plan.problem, contacts="refuse"), plan.trajectory, certificate)
    assert noted.failures == certificate.failures
    assert bool(noted.contacts) is bool(refused.failures) is (beyond < 0)
    if beyond < 0:
        (found,) = noted.contacts
        place = 0.5 * np.sin(plan.trajectory.position_at(np.array([found.since_s]))[0, 0])
        assert place == pytest.approx(GOAL_M + beyond, abs=1e-5)
        assert refused.unrepairable == refused.failures
        assert f"collide at t = {found.since_s:.5g} s" in refused.failures[0]


@pytest.mark.parametrize(("share", "sure"), [(1.01, True), (0.99, False), (np.nan, False)])
@pytest.mark.parametrize("others", [(), (1e-9,)])
def test_a_collision_is_sure_where_it_is_ten_times_deeper_than_the_motion_is_exact(swing, monkeypatch, share, sure, others):
    """The extent times 0.01 degrees, and 1 mm of the slides."""
    problem, trajectory = replace(swing[0.05].problem, contacts="refuse"), swing[0.05].trajectory
    off = structs.replace(swing[0.05].certificate, integration_error_deg=0.01, integration_error_m=1e-3)
    depth = share * 10 * (problem.mechanism.extent_m * np.radians(0.01) + 1e-3)
    found = tuple(meeting(0.5, depth_m) for depth_m in (*others, depth))
    monkeypatch.setattr(further_checks, "meetings", lambda *_: found)
    monkeypatch.setattr(further_checks, "certify", lambda *_: off)
    assert (surely_collides(problem, trajectory) is not None) is sure
    assert surely_collides(replace(problem, contacts="note"), trajectory) is None


@pytest.mark.parametrize(
    ("found", "words"),
    [
        ([meeting(0.25)], "penetrate by up to 1 mm, at t = 0.25 s; contact"),
        ([meeting(0.25, home_depth_m=2e-3)], "at t = 0.25 s, 2 mm at home; contact"),
        ([meeting(0.25), meeting(0.5)], "s, and 1 more pair of geoms after them;"),
        ([meeting(0.25), meeting(0.5), meeting(0.7)], "s, and 2 more pairs of geoms after them;"),
    ],
)
def test_the_first_collision_is_told_and_the_others_are_counted(found, words):
    assert words in further_checks._failure(tuple(found))


def test_contacts_that_begin_are_noted_one_by_one_and_constant_ones_together_with_the_deepest():
    begun, constant = meeting(0.25), [meeting(None, 2e-3), meeting(None, 5e-3, first="c")]
    assert len(contact_notes((begun,))) == 1
    first, rest = contact_notes((begun, *constant))
    assert "from t = 0.25 s on, up to 1 mm deep" in first
    assert "contact of 2 pairs of geoms" in rest
    assert "up to 5 mm deep" in rest
