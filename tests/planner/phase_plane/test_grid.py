"""The part of a grid around a place in which every pose is allowed."""

import numpy as np
import pytest

from linkplan.planner.phase_plane.grid import _around


@pytest.mark.parametrize(
    ("place", "forbidden", "left"),
    [(3.0, [2], (2.0, 4.0)), (1.0, [6], (0.0, 2.0)), (2.0, [1, 7], (1.0, 3.0)), (2.0, [], (0.0, 4.0))],
    ids=["below", "above", "on both sides, between places", "nowhere"],
)
def test_a_grid_is_cut_next_to_the_first_pose_that_is_not_allowed(place, forbidden, left):
    s, poses = np.linspace(0.0, 4.0, 5), np.linspace(0.0, 4.0, 9)[:, None]
    within = np.ones(9, dtype=bool)
    within[forbidden] = False
    kept, at = _around(place, s, poses, within)
    assert (kept[0], kept[-1]) == left
    assert np.array_equal(at[::2, 0], kept)
