"""Errors at ends and waypoints: distances from bounds, and sites on an arm of 1 m that misses its places by known angles."""

import numpy as np
import pytest

from linkplan.planner.certificate.certificate import _waypoint_error
from linkplan.planner.certificate.integration import ends_off_m, exact_bounds, relative_violation, waypoint_off_m
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory
from tests.support.motions import motion_along

ARM = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="J" axis="0 -1 0"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><site name="tip" pos="1 0 0"/><site name="mid" pos="0.5 0 0"/></body>
</worldbody><actuator><motor name="m" joint="J" ctrlrange="-9 9"/></actuator></mujoco>"""


def place(angle: float, radius: float = 1.0) -> list[float]:
    return [radius * float(np.cos(angle)), 0.0, radius * float(np.sin(angle))]


def problem(off: float = 0.0, time_s: float | None = None, kind: str = "reach") -> Problem:
    """Return a motion of sites from 0 to 1 rad by way of 0.5 rad, the ends off by an angle and the waypoint by three."""
    motion = {"kind": kind, "start_at": {"tip": place(off)}, "goal_at": {"tip": place(1.0 - off)}, "duration_s": 2.0}
    way = {"at": {"mid": place(0.5 + 3 * off, 0.5), "tip": place(0.5 + 3 * off)}}
    way |= {} if time_s is None else {"time_s": time_s}
    motion |= {"waypoints": [way]} if kind == "reach" else {}
    tables = {"mechanism": {"model": ARM}, "motion": motion, "objective": {"minimize": "effort"}}
    return Problem.from_tables("arm", tables)


def motion(back: bool = False) -> Trajectory:
    """Return an even motion from 0 to 1 rad that begins at 3 s and lasts two, or goes back in two more."""
    position = [[0.0, 0.5], [0.5, 1.0]] + ([[1.0, 0.5], [0.5, 0.0]] if back else [])
    n = len(position)
    return motion_along(3.0 + np.arange(n + 1), np.array(position).T, periodic=back)


@pytest.mark.parametrize(
    ("values", "expected"), [([3.0, 6.0], 0.0), ([1.5, 6.0], 0.25), ([3.0, 8.5], 0.75), ([1.0, 8.0], 0.5)]
)
def test_a_violation_is_the_largest_distance_from_the_bounds_in_units_of_a_size(values, expected):
    bounds = np.array([2.0, 2.0]), np.array([7.0, 7.0])
    assert relative_violation(np.array(values), bounds, 2.0) == expected


def test_a_value_that_is_asked_for_is_both_bounds_and_a_free_one_none():
    low, high = exact_bounds(np.array([1.0, np.nan]))
    assert (low.tolist(), high.tolist()) == ([1.0, -np.inf], [1.0, np.inf])
    low, high = exact_bounds(np.array([1.0, 2.0]), np.array([True, False]))
    assert (low.tolist(), high.tolist()) == ([-np.inf, 2.0], [np.inf, 2.0])


@pytest.mark.parametrize("time_s", [1.0, None])
def test_sites_are_off_by_the_chords_of_their_angles(time_s):
    """By 1e-3 rad at the ends, and by 3e-3 rad on the whole and on half of the radius at the waypoint."""
    asked = problem(1e-3, time_s)
    q = motion().position_at(motion().dense_times(5))
    worst, said = ends_off_m(asked, motion(), motion().dense_times(5), q)
    assert worst == pytest.approx(3e-3, rel=1e-5)
    assert [sentence.split(" m away")[0] for sentence in said] == [
        "site tip is 0.001",
        "site tip is 0.001",
        "site tip is 0.003",
    ]
    off = waypoint_off_m(asked, motion(), asked.motion.waypoints[0], np.array([4.0, 3.0]))
    by_site = dict(zip([point.site for point in asked.motion.waypoints[0].at], off.T, strict=True))
    assert by_site["tip"] == pytest.approx([3e-3, 2 * np.sin(0.503 / 2)], rel=1e-5)
    assert by_site["mid"] == pytest.approx([1.5e-3, np.sin(0.503 / 2)], rel=1e-5)


@pytest.mark.parametrize(("share", "named"), [(0.9e-6, 0), (1.1e-6, 2)])
def test_sites_may_miss_their_places_by_a_millionth_of_the_extent(share, named):
    extent = problem().mechanism.extent_m
    asked = problem(share * extent)
    time = motion().dense_times(5)
    # The waypoint's sites are off by three times as much.
    _, said = ends_off_m(asked, motion(), time, motion().position_at(time))
    assert sum("motion.start_at" in one or "motion.goal_at" in one for one in said) == named
    assert any("waypoints[0]" in one for one in said)


def test_the_goal_of_a_periodic_motion_is_in_its_middle():
    there_and_back = motion(back=True)
    time = there_and_back.dense_times(5)
    worst, said = ends_off_m(problem(kind="periodic"), there_and_back, time, there_and_back.position_at(time))
    assert worst < 1e-9
    assert said == ()


def test_of_the_sites_of_a_waypoint_the_one_that_is_furthest_off_counts():
    """By 3e-3 rad: the tip twice as far as the middle, as a share of the extent."""
    asked = problem(1e-3)
    error = _waypoint_error(asked, motion(), asked.motion.waypoints[0], 10.0, 1.0)  # so wide that only sites count
    assert error == pytest.approx(3e-3 / asked.mechanism.extent_m, rel=1e-5)
