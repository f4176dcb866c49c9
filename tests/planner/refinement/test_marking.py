"""Which intervals a finer mesh halves: those that an error begins on, and not those that carry it on."""

import numpy as np
import pytest

from linkplan.planner.refinement.marking import marked_for
from tests.support.refinement_states import iterate

# Six intervals: dynamics are not kept on the third, and the integrated state strays from there on.
GROWTH = np.array([0.0, 0.0, 5.0, 20.0, 20.0, 20.0])


@pytest.mark.parametrize(
    ("residual_share", "halved"),
    [
        ([0, 0, 17.0, 0, 0, 0], [2]),
        ([0, 0, 17.0, 0.1, 0, 0.1], [2, 3, 5]),  # others err themselves
        ([0, 0, 0.5, 0, 0, 0], [2, 3, 4, 5]),  # dynamics are kept: every growing error counts
    ],
)
def test_where_dynamics_are_not_kept_what_merely_carries_the_error_is_not_halved(residual_share, halved):
    at = iterate(residual_share=np.maximum(residual_share, 1e-13), growth=GROWTH, n=6)
    assert np.flatnonzero(marked_for(at, 1.0)).tolist() == halved


def test_where_a_growing_error_has_no_number_every_interval_is_halved():
    assert marked_for(iterate(growth=1e306, n=6), 1e4).all()
