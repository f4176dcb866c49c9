"""The smooth path through waypoints that a search begins with."""

import numpy as np
import pytest

from linkplan.planner.closed_chain.guess import first_guess, swinging_guesses
from tests.support.bodies import HINGE, body_problem


@pytest.mark.parametrize(("start", "via", "goal"), [(-60.0, -20.0, 30.0), (60.0, 20.0, -30.0), (0.0, 50.0, 10.0)])
def test_the_path_passes_a_waypoint_at_the_mean_speed_unless_it_turns_there(start, via, goal):
    motion = (
        f'kind = "reach"\nstart_deg = {{ J = {start} }}\ngoal_deg = {{ J = {goal} }}\nduration_s = 1.5\n'
        f"waypoints = [{{ at_deg = {{ J = {via} }}, time_s = 0.5 }}]\n"
    )
    problem = body_problem(HINGE, motion)
    guess, time = first_guess(problem, problem.start_pose()), np.array([0.0, 0.5, 1.5])
    turns = (via - start) * (goal - via) < 0
    at_waypoint = 0.0 if turns else np.radians(goal - start) / 1.5
    np.testing.assert_allclose(guess.position(time)[:, 0], np.radians([start, via, goal]), atol=1e-12)
    np.testing.assert_allclose(guess.velocity(time)[:, 0], [0.0, at_waypoint, 0.0], atol=1e-9)


def test_swings_go_half_the_way_away_from_the_goal_or_half_the_way_past_it():
    """From -10 to 30 deg: back to -30 deg at four tenths of the time, or on to 50 deg at six tenths."""
    motion = 'kind = "reach"\nstart_deg = { J = -10.0 }\ngoal_deg = { J = 30.0 }\nduration_s = 2.0\n'
    back, past = swinging_guesses(body_problem(HINGE, motion), np.radians([-10.0]))
    for guess, at, turn in ((back, 0.8, -30.0), (past, 1.2, 50.0)):
        assert guess.duration_s == 2.0
        assert np.degrees(guess.position(np.array([0.0, at, 2.0]))[:, 0]) == pytest.approx([-10.0, turn, 30.0])
        assert guess.velocity(np.array([0.0, at, 2.0])) == pytest.approx(np.zeros((3, 1)), abs=1e-9)


@pytest.mark.parametrize("turns", [1, -2])
def test_a_turn_with_a_goal_passes_it_half_way_and_ends_whole_turns_beyond_its_start(turns):
    motion = (
        'kind = "periodic"\nstart_deg = { J = 20.0 }\ngoal_deg = { J = 70.0 }\nduration_s = 2.0\n'
        f"turns = {{ J = {turns} }}\n"
    )
    problem = body_problem(HINGE, motion)
    guess, time = first_guess(problem, problem.start_pose()), np.array([0.0, 1.0, 2.0])
    assert np.degrees(guess.position(time)[:, 0]) == pytest.approx([20.0, 70.0, 20.0 + 360.0 * turns])
    assert np.degrees(guess.velocity(time)[:, 0]) == pytest.approx(np.full(3, 180.0 * turns))
