"""Durations that meet the times of phase boundaries, and what a periodic problem is."""

import numpy as np
import pytest

from linkplan.planner.transcription.formulation import PhaseBoundary, stretched_durations
from tests.support.formulations import formulation

FREE = (0.0, np.inf)


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        ([FREE, FREE, FREE], [1.0, 1.0, 2.0, 4.0]),
        ([(0.5, 0.5), FREE, FREE], [0.5, 0.5, 2.0, 4.0]),
        ([FREE, (3.0, 3.0), FREE], [1.5, 1.5, 3.0, 4.0]),
        ([(0.5, 0.5), (3.0, 3.0), FREE], [0.5, 0.5, 5.0, 4.0]),
        ([(0.5, 0.5), FREE, (6.5, 6.5)], [0.5, 0.5, 4.0, 8.0]),
    ],
)
def test_durations_are_stretched_between_prescribed_times_only(times, expected):
    """Phases of 2, 1 and 1 segments; times are in units of 2 s."""
    boundaries = tuple(PhaseBoundary(state=np.zeros((1, 2)), time=time) for time in [(0.0, 0.0), *times])
    found = stretched_durations(np.array([1.0, 1.0, 2.0, 4.0]), boundaries, np.array([0, 0, 1, 2]), 2.0)
    assert found == pytest.approx(expected)


@pytest.mark.parametrize(
    ("returns", "free_at_end", "periodic"),
    [((), (), False), ((0, 1), (), False), ((0, 1, 2), (), True), ((0, 1), (2,), True), ((0,), (2,), False)],
)
def test_a_problem_is_periodic_if_all_states_return_but_those_that_nothing_depends_on(returns, free_at_end, periodic):
    assert formulation(returns=returns, free_at_end=free_at_end, state=np.zeros((3, 2))).periodic == periodic
