"""What trackers need at run time: counts by hand; times are reported and nothing more is asked of them."""

import numpy as np
import pytest

from linkplan.controllers.trackers.names import TRACKERS
from linkplan.studies.compare.compare import compare
from tests.support.plans import optimal


@pytest.fixture(scope="module")
def needs() -> dict:
    plan = optimal("knee-reach", "tracking.period_s=1e-3")
    return compare(plan, None, asked=TRACKERS).run_time


@pytest.mark.parametrize(
    ("name", "remembered", "stored", "operations"),
    [
        # Of one joint and one motor: two errors, two gains and their sum.
        ("pd", 0, 4, 2 + 2 + 1),
        # And the plan's effort added.
        ("pd+ff", 0, 5, 2 + 2 + 1 + 1),
        ("gs-pd+ff", 0, 5, 2 + 2 + 1 + 1),
        ("lqr", 0, 5, 2 + 2 + 1 + 1),
        # A third gain and sum; the integral's product and sum, two comparisons with the limits.
        ("lqi", 1, 6, 2 + 3 + 3 + 2 + 2),
    ],
)
def test_a_linear_law_s_needs_are_those_counted_by_hand(needs, name, remembered, stored, operations):
    found = needs[name]
    assert (found.remembered, found.stored, found.operations) == (remembered, stored, operations)
    assert found.operations_at_limit == operations


def test_what_computes_the_model_needs_more_by_orders_of_magnitude(needs):
    assert needs["ct"].operations > 100 * needs["lqr"].operations
    assert needs["mpc"].operations < needs["ct"].operations < needs["mpc"].operations_at_limit / 10
    assert needs["mpc"].remembered == 20


def test_every_tracker_s_time_is_reported_and_a_user_s_law_is_not_counted(needs):
    assert set(needs) == set(TRACKERS)
    assert all(0 < one.median_us <= one.percentile90_us for one in needs.values())

    class Idle:
        name = "idle"

        def effort(self, *_):
            return np.zeros(1)

    plan = optimal("knee-reach", "tracking.period_s=1e-3")
    found = compare(plan, None, asked=[Idle()]).run_time["idle"]
    assert found.operations is None
    assert found.stored is None
    assert found.median_us > 0
