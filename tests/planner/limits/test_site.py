"""Margins of limits on a site that goes round a hinge on an arm of 1 m, in closed form."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from linkplan.planner.limits.kinds import factor_of
from linkplan.planner.limits.limit import Margin, limit_margin
from linkplan.planner.limits.samples import samples_of
from linkplan.planner.limits.site import SitePathLimit, _tube
from linkplan.planner.problem.instant import free_instant
from linkplan.planner.problem.problem import Problem
from linkplan.planner.trajectory import Trajectory
from tests.support.bodies import UNIT_ARM
from tests.support.motions import motion_along

# From 20 to 110 degrees: x from 0.94 to -0.34, z up to 1 at 90 degrees; t^2 (3 - 2 t) over three seconds.
BEGIN, END, DURATION_S = np.radians(20.0), np.radians(110.0), 3.0
# Of an extreme between samples, by a parabola through three of a fine grid. Measured 2e-9.
FINE_GRID = 1e-8


def problem(**site) -> Problem:
    motion = {"start_deg": {"J": 20.0}, "goal_deg": {"J": 110.0}, "duration_s": DURATION_S}
    return Problem.reach(UNIT_ARM, **motion, limits={"site": {"tip": site}})


def motion(n: int = 3) -> Trajectory:
    """Return it in `n` intervals, by the cubic through the breaks' places and speeds, which is the same polynomial."""
    breaks = np.linspace(0.0, DURATION_S, n + 1)
    share = breaks / DURATION_S
    place = BEGIN + (END - BEGIN) * share**2 * (3 - 2 * share)
    speed = (END - BEGIN) * 6 * share * (1 - share) / DURATION_S
    h = np.diff(breaks)
    p = np.array([place[:-1], place[:-1] + h * speed[:-1] / 3, place[1:] - h * speed[1:] / 3, place[1:]])
    return motion_along(breaks, p)


def margin_of(asked: Problem) -> Margin:
    (limit,) = SitePathLimit.of(asked)
    return limit_margin(limit, samples_of(asked, motion()))


def time_at(angle: float) -> float:
    share = np.linspace(0.0, 1.0, 200_001)
    return DURATION_S * float(np.interp(angle, BEGIN + (END - BEGIN) * share**2 * (3 - 2 * share), share))


@pytest.mark.parametrize(
    ("site", "value", "limit", "upper", "when"),
    [
        ({"z": [-9.0, 0.97]}, 1.0, 0.97, True, np.pi / 2),  # inside of the last interval
        ({"z": [-9.0, 1.25]}, 1.0, 1.25, True, np.pi / 2),
        ({"z": [-0.5, 0.97]}, 1.0, 0.97, True, np.pi / 2),
        ({"x": [-0.1, 9.0]}, np.cos(END), -0.1, False, END),
        ({"x": [-9.0, 0.5]}, np.cos(BEGIN), 0.5, True, BEGIN),
        ({"x": [-0.5, 2.0]}, np.cos(END), -0.5, False, END),
        ({"normal": [0.0, 0.0, -2.0], "at": [3.0, 4.0, 0.97]}, -0.03, 0.0, False, np.pi / 2),
    ],
)
def test_a_margin_is_that_of_the_nearest_instant_to_the_bound(site, value, limit, upper, when):
    found = margin_of(problem(**site))
    assert found.upper is upper
    assert (found.value, found.limit) == pytest.approx((value, limit), abs=FINE_GRID)
    assert found.left == pytest.approx(limit - value if upper else value - limit, abs=FINE_GRID)
    assert found.time_s == pytest.approx(time_at(when), abs=2e-3)
    assert found.kept is (found.left >= 0)


def test_overruns_are_shares_of_the_mechanism_s_extent_in_each_interval():
    asked = problem(z=[-9.0, 0.97])
    found = margin_of(asked)
    assert found.overrun[0] == 0.0
    assert found.overrun[2] == pytest.approx(0.03 / asked.mechanism.extent_m, rel=1e-6)
    # The second interval ends at 20 + 90 * 20 / 27 degrees.
    end = np.sin(BEGIN + (END - BEGIN) * 20 / 27)
    assert found.overrun[1] == pytest.approx(max(0.0, end - 0.97) / asked.mechanism.extent_m, rel=1e-6)


@pytest.mark.parametrize("radius", [0.03, 0.08])
def test_in_a_tube_the_distance_from_the_chord_counts(radius):
    """Of an arc of 90 degrees on a circle of 1 m, the middle of the chord is 1 - sqrt(1/2) away."""
    along = [[float(np.cos(a)), 0.0, float(np.sin(a))] for a in (BEGIN, END)]
    found = margin_of(problem(along=along, radius_m=radius))
    away = 1 - np.sqrt(0.5)
    assert (found.value, found.limit, found.upper) == (pytest.approx(away, abs=1e-8), radius, True)
    assert found.overrun.max() == pytest.approx((away - radius) / radius, rel=1e-6)
    assert found.time_s == pytest.approx(DURATION_S / 2, abs=2e-3)


@pytest.mark.parametrize(
    "site", [{"z": [-0.5, 0.97]}, {"x": [-0.5, 0.97]}, {"normal": [2.0, 0.0, 1.0], "at": [0.25, 5.0, 7.0]}]
)
@pytest.mark.parametrize("angle", [0.3, 1.9])
def test_the_scaled_row_is_as_far_from_its_bounds_as_the_site_is_from_its_limits(site, angle):
    asked, place = problem(**site), np.array([np.cos(angle), 0.0, np.sin(angle)])
    at, (q, *_) = free_instant(asked.mechanism)
    (limit,), (one,) = SitePathLimit.of(asked), asked.limits.site
    row = ca.Function("row", [q], [limit.rows.node(at, ca.SX())])
    for bound, end in zip(limit.bounds(asked, None), (one.low, one.high), strict=True):
        if np.isfinite(end):
            off = one.value(place[None])[0] - end
            assert float(row(angle)) - bound == pytest.approx(off / asked.mechanism.extent_m, abs=1e-12)


def test_a_relaxed_limit_is_further_out_by_a_share_of_the_extent_and_the_factor_asked_for_keeps_the_motion():
    asked = problem(z=[-0.5, 0.97])
    wider = SitePathLimit.relaxed(asked, 1.1).limits.site[0]
    room = 0.1 * asked.mechanism.extent_m
    assert (wider.low, wider.high) == pytest.approx((-0.5 - room, 0.97 + room))
    factor = factor_of(SitePathLimit, asked, motion())
    assert factor == pytest.approx(1 + 0.03 / asked.mechanism.extent_m, rel=1e-3)
    assert margin_of(SitePathLimit.relaxed(asked, factor)).kept
    assert not margin_of(SitePathLimit.relaxed(asked, 1 + 0.9 * (factor - 1))).kept
    tube = problem(along=[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], radius_m=0.5)
    assert SitePathLimit.relaxed(tube, 1.1).limits.site[0].low == tube.limits.site[0].low
    assert factor_of(SitePathLimit, asked.varied(limits=replace(asked.limits, site=())), motion()) is None


def test_what_a_wall_through_the_origin_leaves_is_a_share_of_the_mechanism_s_extent():
    asked = problem(z=[0.0, 9.0])
    left = np.sin(BEGIN)  # at the start: a share of the limit, which is zero, would say nothing
    assert margin_of(asked).share == pytest.approx(left / asked.mechanism.extent_m, rel=1e-9)


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
