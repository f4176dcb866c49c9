"""Errors of boundary conditions: bounds, places of sites, turns, periods and waypoints."""

import numpy as np
import pytest

from linkplan.planner.certificate.certificate import _turn_error, _waypoint_error, end_state_error
from linkplan.planner.certificate.integration import ends_off_m, relative_violation, waypoint_off_m
from linkplan.planner.problem.limits import exact_bounds
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory
from tests.support.arms import LOWER, UPPER, angles_at, foot_of
from tests.support.bodies import HINGE, UNIT_ARM, body_problem
from tests.support.motions import motion_along
from tests.support.sites import ABOVE, BELOW, arm_of, site_problem


def place(angle: float, radius: float = 1.0) -> list[float]:
    return [radius * float(np.cos(angle)), 0.0, radius * float(np.sin(angle))]


def problem(off: float = 0.0, time_s: float | None = None, kind: str = "reach") -> Problem:
    """Return a motion of sites from 0 to 1 rad by way of 0.5 rad, the ends off by an angle and the waypoint by three."""
    motion = {"kind": kind, "start_at": {"tip": place(off)}, "goal_at": {"tip": place(1.0 - off)}, "duration_s": 2.0}
    way = {"at": {"mid": place(0.5 + 3 * off, 0.5), "tip": place(0.5 + 3 * off)}}
    way |= {} if time_s is None else {"time_s": time_s}
    motion |= {"waypoints": [way]} if kind == "reach" else {}
    tables = {"mechanism": {"model": UNIT_ARM}, "motion": motion, "objective": {"minimize": "effort"}}
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


TURN = 'kind = "periodic"\nturns = {{ J = {turns} }}\nduration_s = 0.5\n'


@pytest.mark.parametrize("turns", [1, -2])
@pytest.mark.parametrize("missed", [0.0, 0.1])
def test_a_turn_ends_where_it_began_and_whole_turns_further(turns, missed):
    problem = body_problem(HINGE, TURN.format(turns=turns))
    travelled = 2 * np.pi * turns + missed
    motion = motion_along([0.0, 0.5], [0.3, 0.3 + travelled], periodic=True)
    assert end_state_error(problem, motion, 2 * abs(travelled)) == pytest.approx(missed / abs(travelled), abs=1e-12)


@pytest.mark.parametrize(("faster", "error"), [(1.0, 0.0), (1.25, 0.25)])
def test_a_periodic_motion_returns_with_the_speed_that_it_began_with(faster, error):
    problem = body_problem(HINGE, TURN.format(turns=1))
    speed = 2 * np.pi / 0.5
    motion = motion_along([0.0, 0.5], [0.0, 2 * np.pi], velocity=speed * np.array([1.0, faster]), periodic=True)
    assert end_state_error(problem, motion, speed) == pytest.approx(error, abs=1e-12)


def test_errors_of_a_motion_that_stands_still_are_shares_of_a_nanometre():
    problem = body_problem(HINGE, 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 0.0 }\nduration_s = 0.5\n')
    still = np.full((2, 1, 1), 2e-10)
    motion = motion_along([0.0, 0.5], still, start_pose=np.zeros(1))
    assert end_state_error(problem, motion, 1.0) == pytest.approx(0.2)
    problem = body_problem(HINGE, TURN.format(turns=1))
    assert _turn_error(problem, np.array([[0.0], [3e-10]])) == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("place", "speed", "error"), [(1.0, None, 0.0), (1.2, None, 0.1), (1.0, 2.2, 0.1), (0.4, None, 0.2)]
)
def test_a_waypoint_of_any_time_is_missed_by_the_error_at_the_nearest_break(place, speed, error):
    """At an even 2 rad/s through breaks at 0, 1 and 2 rad, waypoints at a place, and at a speed."""
    asked = f"at_deg = {{ J = {np.degrees(place):.15g} }}"
    asked += "" if speed is None else f", speed_deg_s = {{ J = {np.degrees(speed):.15g} }}"
    ends = f"start_deg = {{ J = 0.0 }}\ngoal_deg = {{ J = {np.degrees(2.0):.15g} }}\n"
    ends += "".join(f"{end}_speed_deg_s = {{ J = {np.degrees(2.0):.15g} }}\n" for end in ("start", "goal"))
    problem = body_problem(HINGE, f'kind = "reach"\n{ends}duration_s = 1.0\nwaypoints = [{{ {asked} }}]\n')
    motion = motion_along([0.0, 0.5, 1.0], [[0.0, 1.0], [1.0, 2.0]])
    assert end_state_error(problem, motion, 2.0) == pytest.approx(error, abs=1e-12)
