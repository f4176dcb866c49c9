"""The number of parts into which intervals are divided, for given errors."""

import numpy as np
import pytest

from linkplan.planner.search.pieces import for_a_correction, for_a_solve
from tests.support.refinement_states import iterate, state


def parts(*, bent: bool = False, **errors) -> list[int]:
    """Return the number of parts into which a correction divides each of six intervals."""
    at = iterate(n=6, **errors)
    return for_a_correction(state(at).case, at, bent=bent).tolist()


def test_an_error_of_the_integrated_state_divides_the_interval_that_caused_it():
    """The integrated state leaves the motion on the third interval, and its error grows on all later ones."""
    growth, residual = [0.0, 0.0, 5.0, 20.0, 20.0, 20.0], [1e-9, 1e-9, 0.1, 1e-9, 1e-9, 1e-9]
    assert parts(growth=growth, residual_share=residual) == [1, 1, 6, 1, 1, 1]
    assert parts(growth=0.08, residual_share=residual) == [1] * 6  # half of the allowed error in all
    assert parts(growth=np.inf, residual_share=residual)[2] == 6


@pytest.mark.parametrize(("bent", "expected"), [(False, [1, 2, 3, 6, 1, 1]), (True, [1, 3, 6, 12, 1, 1])])
def test_a_bend_inside_an_interval_takes_more_parts_than_the_order_of_the_scheme(bent, expected):
    """Efforts exceed their limit by 8, 27 and 1e6 times the allowance. The scheme has degree 3."""
    assert parts(effort_overrun=[0.5, 8.0, 27.0, 1e6, 0.0, 1.0], bent=bent) == expected


def test_a_mesh_is_too_coarse_for_a_solve_where_its_dynamics_or_limits_are_exceeded():
    at = iterate(n=6, residual_share=[0.1, 0.3, 0.0, 0.0, 0.0, 0.0], overrun=[0.0, 0.0, 2e-4, 4e-4, 1.0, 0.0])
    assert for_a_solve(state(at).case, at).tolist() == [1, 2, 1, 2, 4, 1]
