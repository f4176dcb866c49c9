"""Tightening of a limit: where a motion overran it, and by a little more than that."""

import numpy as np
import pytest

from linkplan.planner.refinement.marking import evened, tightened_share, tightenings_of


@pytest.mark.parametrize("begin_s", [0.0, 2.0])
def test_a_speed_limit_is_tightened_on_the_intervals_where_it_is_overrun_at_shares_of_the_duration(begin_s):
    overrun = np.array([[0.0, 0.0], [0.0, 1e-3]])
    (found,) = tightenings_of((), overrun, begin_s + np.array([0.0, 1.0, 4.0]))
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
    (found,) = evened(tightenings_of((), np.array([[0.0, overrun, 0.0]]), np.arange(4.0)))
    assert found.share.max() == pytest.approx(tightened_share(np.array([overrun]))[0])
    assert bool(np.ptp(found.share) == 0) is is_even
