"""The smooth distance of a place from a path in space, against the distance from its nearest segment."""

import casadi as ca
import numpy as np
import pytest

from linkplan.planner.limits.site import _tube

ALONG, RADIUS = np.array([[0.1, 0.0, 0.2], [0.5, 0.0, 0.2], [0.5, 0.3, 0.2]]), 0.05


def squared_radii(place: np.ndarray) -> float:
    p = ca.SX.sym("p", 3)
    return float(ca.Function("tube", [p], [_tube(p, ALONG, RADIUS)])(place))


@pytest.mark.parametrize(
    ("place", "distance"),
    [
        ([0.2, 0.0, 0.23], 0.03),
        ([0.52, 0.2, 0.2], 0.02),
        ([0.07, 0.0, 0.16], 0.05),  # before the first place
        ([0.5, 0.34, 0.17], 0.05),  # beyond the last
        ([0.3, 0.0, 0.2], 0.0),
    ],
)
def test_away_from_the_bend_the_distance_is_that_from_the_nearest_segment(place, distance):
    assert squared_radii(np.array(place)) == pytest.approx((distance / RADIUS) ** 2, abs=1e-9)


def test_near_the_bend_the_distance_is_never_underestimated():
    for x, y in np.random.default_rng(0).uniform(-0.05, 0.05, (20, 2)):
        place = ALONG[1] + [x, y, 0.0]
        nearest = min(np.hypot(max(0.0, x), y), np.hypot(x, min(0.0, y)))
        assert squared_radii(place) >= (nearest / RADIUS) ** 2 - 1e-9
