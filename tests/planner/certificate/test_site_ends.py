"""Errors of sites at a motion's ends and waypoints, against the arm's kinematics by hand."""

import numpy as np
import pytest

from linkplan.planner.certificate.integration import ends_off_m
from tests.support.arms import LOWER, UPPER, angles_at, foot_of
from tests.support.motions import motion_along
from tests.support.sites import ABOVE, BELOW, arm_of, site_problem

FROM, TO = angles_at(0.3, 0.35, -1.0), angles_at(0.3, -0.35, -1.0)
HALFWAY = foot_of(0.5 * (FROM + TO))[0].tolist()
WANTED = {"start": ABOVE, "waypoint": HALFWAY, "goal": BELOW}
MISS_M = 1e-3


def distance_m(wanted: dict, **time: float) -> tuple[float, tuple[str, ...]]:
    """Return the errors of the straight line from FROM to TO in joint space, in two intervals of half a second."""
    waypoint = {"at": {"foot": wanted["waypoint"]}, **time}
    motion = {"start_at": {"foot": wanted["start"]}, "goal_at": {"foot": wanted["goal"]}, "waypoints": [waypoint]}
    problem = site_problem(arm_of(UPPER, LOWER), motion | {"duration_s": 1.0})
    line = np.array([[FROM, 0.5 * (FROM + TO)], [0.5 * (FROM + TO), TO]])
    trajectory = motion_along([0.0, 0.5, 1.0], line)
    time = np.linspace(0.0, 1.0, 11)
    return ends_off_m(problem, trajectory, time, trajectory.position_at(time))


@pytest.mark.parametrize("time", [{"time_s": 0.5}, {}], ids=["at its time", "at some break"])
def test_a_motion_that_meets_every_place_has_no_error(time):
    worst, failures = distance_m(WANTED, **time)
    assert worst < 1e-9
    assert failures == ()


@pytest.mark.parametrize(
    ("which", "key"), [("start", "motion.start_at"), ("waypoint", "motion.waypoints[0].at"), ("goal", "motion.goal_at")]
)
def test_a_place_that_the_motion_misses_is_named_with_the_distance(which, key):
    worst, failures = distance_m(WANTED | {which: np.subtract(WANTED[which], [MISS_M, 0.0, 0.0]).tolist()})
    assert worst == pytest.approx(MISS_M, rel=1e-6)
    assert len(failures) == 1
    assert key in failures[0]
    assert "0.001 m away" in failures[0]


def test_a_waypoint_that_is_met_at_another_time_is_missed():
    assert distance_m(WANTED, time_s=0.3)[0] > MISS_M
