"""Which extra limits and costs there can be."""

import numpy as np
import pytest

from linkplan.models.errors import ProblemError
from linkplan.planner.problem.extra import ExtraCost, ExtraLimit


def limit(lower: float, upper: float) -> ExtraLimit:
    return ExtraLimit(name="speed", expression=lambda at: at.velocity_rad_s["J"], lower=lower, upper=upper)


@pytest.mark.parametrize(
    ("lower", "upper", "size"), [(-3.0, 2.0, 3.0), (-np.inf, 0.5, 0.5), (0.25, np.inf, 0.25), (0.0, np.inf, 1.0)]
)
def test_the_size_of_a_limit_is_that_of_its_larger_finite_bound(lower, upper, size):
    assert limit(lower, upper).size == size


@pytest.mark.parametrize(("lower", "upper"), [(2.0, -3.0), (1.0, 1.0), (-np.inf, np.inf), (np.nan, 1.0)])
def test_a_limit_that_allows_nothing_or_everything_is_refused(lower, upper):
    with pytest.raises(ProblemError, match="speed"):
        limit(lower, upper)


@pytest.mark.parametrize(("weight", "is_legal"), [(1e-3, True), (0.0, False), (-1.0, False), (np.inf, False)])
def test_the_weight_of_a_cost_is_positive(weight, is_legal):
    def cost() -> ExtraCost:
        return ExtraCost(name="swing", expression=lambda at: at.velocity_rad_s["J"] ** 2, weight=weight)

    if is_legal:
        assert cost().weight == weight
        return
    with pytest.raises(ProblemError, match="weight is a positive number"):
        cost()
