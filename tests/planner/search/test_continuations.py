"""What decides on the way to longer motions: what a step saved, and how near a motion comes to a singular pose."""

import numpy as np
import pytest

from linkplan.planner.closed_chain.guess import Guess
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.continuations import nears_singular


@pytest.mark.parametrize(("furthest", "nears"), [(0.5, False), (1.36, True)])
def test_a_motion_nears_a_singular_pose_where_it_comes_within_half_the_distance_of_its_ends(furthest, nears):
    """The knee's crank from 0.4 rad to `furthest` and back; at 1.37 rad its loop is next to a singular pose."""
    problem = load_problem("knee-sprint")
    begin = 0.4

    def position(t: np.ndarray) -> np.ndarray:
        return (begin + (furthest - begin) * np.sin(np.pi * t))[:, None]

    guess = Guess(
        position=position,
        velocity=position,
        acceleration=position,
        effort=None,
        duration_s=1.0,
        start_pose=problem.start_pose(),
    )
    assert nears_singular(problem, guess) is nears
