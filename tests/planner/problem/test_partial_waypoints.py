"""Waypoints that name one of several joints: the others are free there, and what follows from them is not named."""

import numpy as np
import pytest

from linkplan.models.errors import ProblemError
from linkplan.planner.search.planning import plan_motion
from tests.support.plans import optimal, problem_of
from tests.support.tolerances_planner import WAYPOINT_DEG

AT_O1 = "motion.waypoints=[{ at_deg = { O1 = -97.0 }, time_s = 0.2 }]"
P_AT_START = 47.15635695640367


def at_waypoint(plan) -> np.ndarray:
    return np.degrees(plan.trajectory.position_at(np.array([0.2]))[0])


@pytest.mark.slow
def test_a_waypoint_of_one_joint_is_passed_by_it_and_leaves_the_other_free():
    plan = optimal("five-bar-reach", AT_O1)
    O2 = at_waypoint(plan)[1]
    assert at_waypoint(plan)[0] == pytest.approx(-97.0, abs=WAYPOINT_DEG)
    assert abs(at_waypoint(optimal("five-bar-reach"))[0] + 97.0) > 0.2  # it is no accident
    held = optimal("five-bar-reach", f"motion.waypoints=[{{ at_deg = {{ O1 = -97.0, O2 = {O2 + 0.5} }}, time_s = 0.2 }}]")
    assert at_waypoint(held)[1] == pytest.approx(O2 + 0.5, abs=WAYPOINT_DEG)
    assert plan.objective < held.objective  # the other stands where that costs least
    again = optimal("five-bar-reach", f"motion.waypoints=[{{ at_deg = {{ O1 = -97.0, O2 = {O2} }}, time_s = 0.2 }}]")
    assert plan.objective == pytest.approx(again.objective, rel=1e-4)


def test_a_waypoint_of_one_joints_speed_leaves_the_rest_free():
    plan = optimal("five-bar-reach", "motion.waypoints=[{ speed_deg_s = { O2 = 20.0 }, time_s = 0.2 }]")
    assert np.degrees(plan.trajectory.velocity_at(np.array([0.2]))[0, 1]) == pytest.approx(20.0, abs=1e-6)


@pytest.mark.parametrize(
    ("waypoint", "words"),
    [
        ("{ at_deg = { O1 = -97.0, O2 = nan } }", ["joint O2 is a number, got nan"]),
        ("{ at_deg = { O1 = -97.0, P = 60.0 } }", ["of joint P", "follows from O1, O2"]),
        ("{ at_deg = { O1 = -90.0, O2 = -90.0, P = 60.0 } }", ["does not close", "the loop has P at"]),
    ],
)
def test_what_a_waypoint_cannot_mean_is_refused(waypoint, words):
    with pytest.raises(ProblemError) as refused:
        problem_of("five-bar-reach", f"motion.waypoints=[{waypoint}]")
    for word in words:
        assert word in str(refused.value)


def test_a_dependent_joint_of_a_waypoint_that_fits_is_taken():
    waypoint = f"{{ at_deg = {{ O1 = -90.0, O2 = -90.0, P = {P_AT_START} }} }}"
    assert problem_of("five-bar-reach", f"motion.waypoints=[{waypoint}]").motion.waypoints


def test_a_waypoint_of_one_joint_beyond_its_range_is_refused():
    problem = problem_of("five-bar-reach", "limits.range_deg={ O1 = [-120.0, -80.0] }", AT_O1.replace("-97", "-130"))
    with pytest.raises(ProblemError, match=r"O1 = -130 deg is beyond reach: O1 reaches from -120 to -80 deg"):
        plan_motion(problem)
