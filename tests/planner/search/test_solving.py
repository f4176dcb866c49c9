"""First meshes of guesses: how many intervals, and where they lie."""

import numpy as np
import pytest

from linkplan.planner.closed_chain.guess import Guess
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.solving import INTERVALS_PER_SWING, first_mesh, graded_mesh
from tests.support.bodies import HINGE, QUARTER_TURN, body_problem


def problem(*settings: str) -> Problem:
    return body_problem(HINGE, QUARTER_TURN + "duration_s = 4.0\n", *settings)


def guess(position, velocity, duration: float = 4.0, **given) -> Guess:
    return Guess(
        position=lambda t: position(t)[:, None],
        velocity=lambda t: velocity(t)[:, None],
        acceleration=lambda t: 0 * t[:, None],
        effort=None,
        duration_s=duration,
        start_pose=np.zeros(1),
        **given,
    )


def even(**given) -> Guess:
    return guess(lambda t: t, np.ones_like, **given)


@pytest.mark.parametrize("swings", [1, 2, 3, 9])
def test_a_first_mesh_has_the_intervals_asked_for_and_some_for_every_swing(swings):
    mesh, durations = first_mesh(problem("mesh.intervals=31"), even(swings=swings))
    assert mesh.n_intervals == max(31, INTERVALS_PER_SWING * swings if swings > 1 else 0)
    assert durations.tolist() == [4.0]
    assert mesh.n_segments == 1


def test_phases_of_a_guess_are_phases_of_its_first_mesh():
    mesh, durations = first_mesh(problem("mesh.intervals=40"), even(boundaries_s=np.array([0.0, 1.0, 4.0])))
    assert durations.tolist() == [1.0, 3.0]
    assert mesh.n_phases == mesh.n_segments == 2
    assert np.bincount(mesh.segment).tolist() == [10, 30]


def test_an_even_motion_has_an_even_mesh_between_its_switches():
    """Of 20 intervals in 4 s, 5 lie in the first second and 15 in the others; a segment has three at least."""
    mesh, durations = graded_mesh(even(), np.array([1.0]), 20)
    assert durations.tolist() == [1.0, 3.0]
    assert np.bincount(mesh.segment).tolist() == [5, 15]
    np.testing.assert_allclose(mesh.fraction, np.repeat([1 / 5, 1 / 15], [5, 15]))
    short, _ = graded_mesh(even(), np.array([0.1]), 20)
    assert np.bincount(short.segment).tolist() == [3, 20]


def test_a_mesh_is_finer_where_a_motion_is_quick():
    """At speeds of 1 and 3 for half of the time each, a quarter and three quarters of the way, with the change between.

    The shares of the halves are the means of 1/2 of the time, 1/4 and 3/4 of the way, and 0 and 1 of the change of speed,
    which is in the second half.
    """

    def position(t: np.ndarray) -> np.ndarray:
        return np.where(t < 2.0, t, 2.0 + 3.0 * (t - 2.0))

    mesh, _ = graded_mesh(guess(position, lambda t: np.where(t <= 2.0, 1.0, 3.0)), np.array([2.0]), 36)
    assert np.bincount(mesh.segment).tolist() == [9, 27]


def test_switches_lie_in_the_phases_in_which_they_are():
    mesh, durations = graded_mesh(even(boundaries_s=np.array([0.0, 1.5, 4.0])), np.array([3.0, 0.5]), 40)
    assert durations == pytest.approx([0.5, 1.0, 1.5, 1.0])
    assert mesh.phase.tolist() == [0, 0, 1, 1]
