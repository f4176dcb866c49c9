"""The bound on detours: it says no only where the whole phase plane knows of nothing quicker."""

import numpy as np
import pytest

from linkplan.planner.phase_plane import energy_bounds
from linkplan.planner.phase_plane.bang_bang_motions import least_time_guess, parts_of
from linkplan.planner.phase_plane.energy_bounds import quicker_may_exist
from linkplan.planner.phase_plane.grid import grid_of, plane_of
from linkplan.planner.problem.problem import Problem, load_problem
from tests.support.fourbar_problems import kind_of, random_case

NUMBERS = [k for k in range(60) if kind_of(1, k) in ("least time", "weak", "range")]


def look(problem, duration):
    pose = problem.start_pose()
    return quicker_may_exist(problem, pose, duration), least_time_guess(problem, pose)


def test_the_sprint_needs_no_closer_look():
    may, _ = look(load_problem("knee-sprint"), 0.12185127)
    assert not may


def test_a_motion_that_takes_its_time_asks_for_one():
    may, _ = look(load_problem("knee-sprint"), 0.3)
    assert may


@pytest.mark.parametrize("effort", [1.0, 0.1])
def test_bounds_of_legs_are_below_their_times_and_near_them(effort):
    problem = load_problem("knee-sprint")
    (part,) = parts_of(problem.motion)
    grid = grid_of(problem, part.places, problem.start_pose(), 400, graded=False)
    plane = plane_of(problem, *grid, effort * problem.limits.effort)
    places = np.linspace(0, len(plane.s) - 1, 30).round().astype(int)
    legs = np.full((30, 30), np.inf)
    for row, place in enumerate(places.tolist()):
        legs[row, row + 1 :] = energy_bounds._legs(plane, place, places[row + 1 :], +1)
        legs[row, :row] = energy_bounds._legs(plane, place, places[:row], -1)
    there = np.isfinite(legs)
    assert there.sum() > 100
    share = energy_bounds._bounds(plane, places)[there] / legs[there]
    assert share.max() < 1 + 1e-12
    assert np.median(share) > 0.99


def test_the_least_detour_is_the_quickest_chain_of_two_legs_or_more():
    """From 0 to 3: 0 3 is left out, 0 1 3 takes 9, 0 2 3 takes 8, and 0 1 2 3 takes 7."""
    times = np.full((4, 4), np.inf)
    for (a, b), time in {(0, 1): 3.0, (1, 3): 6.0, (0, 2): 5.0, (1, 2): 1.0, (2, 3): 3.0, (0, 3): 1.0}.items():
        times[a, b] = time
    assert energy_bounds._least_detour(times, 0, 3) == 7.0
    times[1, 2] = np.inf
    assert energy_bounds._least_detour(times, 0, 3) == 8.0
    assert energy_bounds._least_detour(times, 3, 0) == np.inf


@pytest.mark.parametrize("number", NUMBERS)
def test_what_is_ruled_out_is_not_there(number):
    case = random_case(1, number)
    if not case.feasible or case.tables["objective"].get("minimize") != "time":
        pytest.skip("no least time")
    problem = Problem.from_tables("detour", case.tables)
    may, quickest = look(problem, case.duration)
    if not may:
        assert quickest.duration_s > 0.998 * case.duration
    if quickest is not None and quickest.swings > 1 and quickest.duration_s < 0.98 * 1.1 * case.duration:
        assert look(problem, 1.1 * case.duration)[0]  # a straight motion that much slower would not be the last word


def test_a_start_at_speed_is_left_to_the_closer_look():
    problem = load_problem("knee-sprint", ["motion.start_speed_deg_s={O=50}"])
    assert look(problem, 0.12)[0]
    assert np.isfinite(problem.motion.start_speed).all()
