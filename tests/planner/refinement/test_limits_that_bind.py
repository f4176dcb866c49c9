"""Which multipliers say that a limit binds, and which that an arc is held wrongly."""

import numpy as np

from linkplan.planner.refinement.constrained_arcs import _wrong


def test_a_push_away_from_a_limit_is_wrong_above_a_hundredth_of_the_largest():
    pushes = np.array([[1.0, -0.005], [-0.02, 0.0]])
    assert _wrong(pushes).tolist() == [[False, False], [True, False]]
