"""Tightening of a limit: where a motion overran it, and by a little more than that."""

import numpy as np
import pytest

from linkplan.planner.limits.joints import RangeLimit, SpeedLimit
from linkplan.planner.limits.limit import Margin, Tightened
from linkplan.planner.refinement.marking import (
    TightenedRow,
    Tightening,
    evened,
    tightened_share,
    tightening_over,
    tightenings_of,
)


def speed_margin(joint: int, overrun: list[float]) -> Margin:
    """Return a joint's margin to a speed limit of 1 that it overruns on intervals."""
    most = max(overrun)
    given = {"name": "J", "unit": "rad/s", "time_s": 0.0, "upper": True, "size": 1.0, "limit": 1.0}
    return Margin(of=SpeedLimit(joint), value=1.0 + most, left=-most, overrun=np.array(overrun), **given)


def test_a_range_is_tightened_in_the_problem_and_not_on_intervals():
    given = {"name": "J", "unit": "rad", "time_s": 0.0, "upper": True, "size": 1.0, "limit": 1.0}
    over = Margin(of=RangeLimit(0, None), value=1.1, left=-0.1, overrun=np.full(3, 0.1), **given)
    assert not over.kept
    assert tightenings_of((over,), np.arange(4.0)) == ()


def test_an_infinite_overrun_is_not_removed_by_a_tightening():
    """A jump of acceleration is of an infinite jerk; bounds tightened by it would be no numbers."""
    assert tightenings_of((speed_margin(0, [0.0, np.inf]),), np.arange(3.0)) == ()


@pytest.mark.parametrize("begin_s", [0.0, 2.0])
def test_a_speed_limit_is_tightened_on_the_intervals_where_it_is_overrun_at_shares_of_the_duration(begin_s):
    margins = (speed_margin(0, [0.0, 0.0]), speed_margin(1, [0.0, 1e-3]))
    (found,) = tightenings_of(margins, begin_s + np.array([0.0, 1.0, 4.0]))
    assert (found.what, found.item) == ("speed", 1)
    np.testing.assert_allclose(found.breaks, [0.0, 0.25, 1.0])
    assert found.share[0] == 0.0
    assert 1e-3 < found.share[1] < 1.5e-3


def test_a_tightening_exceeds_the_overrun_that_it_removes():
    overrun = np.geomspace(1e-9, 0.1, 9)
    assert np.all(tightened_share(overrun) > 1.05 * overrun)
    assert tightened_share(np.zeros(1)) == 0.0


@pytest.mark.parametrize(("overrun", "is_even"), [(1e-6, True), (1e-4, False)])
def test_a_little_tightening_is_the_same_on_all_intervals(overrun, is_even):
    (found,) = evened(tightenings_of((speed_margin(0, [0.0, overrun, 0.0]),), np.arange(4.0)))
    assert found.share.max() == pytest.approx(tightened_share(np.array([overrun]))[0])
    assert bool(np.ptp(found.share) == 0) is is_even


def test_a_tightening_is_a_ten_millionth_of_the_limit_at_the_least():
    assert 1e-7 <= tightened_share(np.array([1e-12]))[0] < 5e-7


ROWS = [TightenedRow("power", 0, Tightened.BY_SHARE), TightenedRow("tube", 1, Tightened.IN_UNITS)]


def tightened(share: list[float], limit: list[float], breaks_s: np.ndarray, *, upper: bool = True, item: int = 0):
    """Return by how much two path limits are tightened on the intervals of a mesh; the shares are of [0, 0.25, 1]."""
    one = Tightening(
        what=ROWS[item].what, item=ROWS[item].item, breaks=np.array([0.0, 0.25, 1.0]), share=np.array(share), upper=upper
    )
    return tightening_over((one,), ROWS, np.array([limit, limit]))(breaks_s)


@pytest.mark.parametrize("begin_s", [0.0, 3.0])
def test_each_interval_of_another_mesh_is_tightened_as_the_one_around_its_middle(begin_s):
    breaks = begin_s + np.array([0.0, 0.4, 0.8, 2.0, 4.0])
    found = tightened([0.1, 0.02], [-3.0, 4.0], breaks)
    assert found[:, 0] == pytest.approx([0.4, 0.4, 0.08, 0.08])
    assert not found[:, 1].any()
    assert tightened([0.1, 0.02], [-3.0, 4.0], breaks, upper=False)[:, 0] == pytest.approx([0.3, 0.3, 0.06, 0.06])


def test_a_limit_in_units_is_tightened_by_the_share_itself():
    assert tightened([0.1, 0.02], [-3.0, 4.0], np.array([0.0, 0.1, 1.0]), item=1)[:, 1] == pytest.approx([0.1, 0.02])


@pytest.mark.parametrize(("limit", "most"), [([1.0, 4.0], 1.35), ([-4.0, -1.0], 1.35), ([-np.inf, 4.0], 40.0)])
def test_two_bounds_keep_a_tenth_of_their_distance(limit, most):
    found = tightened([10.0, 0.0], limit, np.array([0.0, 0.1, 1.0]))
    assert found[:, 0] == pytest.approx([min(10.0 * abs(limit[1]), most), 0.0])
