"""Durations of segments at their bounds, where a program would move a switch further."""

from types import SimpleNamespace

import numpy as np
import pytest

from linkplan.planner.refinement.switch_search import at_bounds

LOWER, UPPER = 1e-3, 1e3


@pytest.mark.parametrize(
    ("duration", "is_at_bound"),
    [(1.01 * LOWER, True), (1.03 * LOWER, False), (1.0, False), (UPPER / 1.03, False), (UPPER / 1.01, True)],
)
@pytest.mark.parametrize("fixed", [False, True])
def test_a_duration_is_at_its_bound_by_its_factor_from_it_and_a_fixed_one_never(duration, is_at_bound, fixed):
    layout = SimpleNamespace(durations=lambda: np.array([1, 2]))
    x = np.array([0.0, duration, 0.7])
    lower, upper = np.array([-1.0, x[1] if fixed else LOWER, 0.1]), np.array([1.0, x[1] if fixed else UPPER, 2.0])
    transcribed = SimpleNamespace(program=SimpleNamespace(layout=layout), lower=lower, upper=upper)
    assert at_bounds(SimpleNamespace(transcribed=transcribed, x=x)) is (is_at_bound and not fixed)
