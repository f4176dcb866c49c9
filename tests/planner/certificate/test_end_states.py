"""The states at both ends of a motion, against those that are asked."""

import numpy as np
import pytest

from linkplan.planner.certificate.certificate import _turn_error, end_state_error
from tests.support.bodies import HINGE, body_problem
from tests.support.motions import motion_along

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
