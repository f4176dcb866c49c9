"""The states at both ends of a motion, against those that are asked."""

import numpy as np
import pytest

from linkplan.planner.certificate.certificate import end_state_error
from linkplan.planner.trajectory import Trajectory
from tests.support.bodies import HINGE, body_problem

TURN = 'kind = "periodic"\nturns = {{ J = {turns} }}\nduration_s = 0.5\n'


@pytest.mark.parametrize("turns", [1, -2])
@pytest.mark.parametrize("missed", [0.0, 0.1])
def test_a_turn_ends_where_it_began_and_whole_turns_further(turns, missed):
    problem = body_problem(HINGE, TURN.format(turns=turns))
    travelled = 2 * np.pi * turns + missed
    motion = Trajectory(
        breaks_s=np.array([0.0, 0.5]),
        position=np.array([0.3, 0.3 + travelled]).reshape(2, 1, 1),
        velocity=np.full((1, 1, 1), 2 * travelled),
        effort=np.zeros((1, 1, 1)),
        start_pose=np.array([0.3]),
        periodic=True,
    )
    assert end_state_error(problem, motion, 2 * abs(travelled)) == pytest.approx(missed / abs(travelled), abs=1e-12)


@pytest.mark.parametrize(("faster", "error"), [(1.0, 0.0), (1.25, 0.25)])
def test_a_periodic_motion_returns_with_the_speed_that_it_began_with(faster, error):
    problem = body_problem(HINGE, TURN.format(turns=1))
    speed = 2 * np.pi / 0.5
    motion = Trajectory(
        breaks_s=np.array([0.0, 0.5]),
        position=np.array([0.0, 2 * np.pi]).reshape(2, 1, 1),
        velocity=speed * np.array([1.0, faster]).reshape(2, 1, 1),
        effort=np.zeros((1, 1, 1)),
        start_pose=np.zeros(1),
        periodic=True,
    )
    assert end_state_error(problem, motion, speed) == pytest.approx(error, abs=1e-12)
