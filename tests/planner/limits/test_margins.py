"""The margin of a quantity along a motion to the nearer end of its limit, against parabolas."""

import numpy as np
import pytest

from linkplan.planner.limits.limit import Measured, margin_of
from linkplan.planner.limits.samples import Samples, samples_of
from tests.support.bodies import HINGE, QUARTER_TURN, body_problem
from tests.support.motions import motion_along


def parabolas() -> Samples:
    """Return a hinge's motion by 20 (t - 0.37)^2 + 3 in its first second, and 20 (t - 1.37)^2 - 2 in the next."""
    begin, slope, end = 20 * 0.37**2, -40 * 0.37, 20 * 0.63**2
    position = np.array([begin, begin + slope / 2, end])[:, None] + np.array([3.0, -2.0])
    motion = motion_along(np.arange(3.0), position)
    return samples_of(body_problem(HINGE, QUARTER_TURN + "duration_s = 2.0\n"), motion)


SAMPLES = parabolas()
CURVE, POINTS = SAMPLES.q[:, 0], SAMPLES.points


@pytest.mark.parametrize(
    ("sign", "bounds", "upper", "left", "overruns"),
    [
        (1.0, (-1.0, 29.0), False, -1.0, (0.0, 1.0)),
        (-1.0, (-29.0, 1.0), True, -1.0, (0.0, 1.0)),
        (1.0, (-4.0, 29.0), False, 2.0, (0.0, 0.0)),
        (-1.0, (-np.inf, 4.0), True, 2.0, (0.0, 0.0)),
    ],
)
def test_the_extreme_of_a_parabola_is_the_value_nearest_to_its_limit(sign, bounds, upper, left, overruns):
    margin = margin_of(None, Measured("q", sign * CURVE, bounds, "N"), SAMPLES)
    assert margin.upper is upper
    assert margin.limit == bounds[upper]
    assert margin.value == pytest.approx(-2.0 * sign, rel=1e-9)
    assert margin.left == pytest.approx(left, rel=1e-9)
    assert margin.overrun == pytest.approx(overruns, rel=1e-9)
    assert margin.time_s == pytest.approx(1.37, abs=0.1)
    assert margin.kept is (left >= 0)


def test_an_interval_with_a_kink_has_the_least_of_its_samples():
    values, bent = np.concatenate([20 * (POINTS - 0.37) ** 2 - 2.0, POINTS + 5.0]), np.arange(2 * len(POINTS)) == 3
    margin = margin_of(None, Measured("q", values, (0.0, np.inf), "N", bent=bent), SAMPLES)
    assert margin.left == values.min()
