"""The reserve of effort ranges for feedback: a share that is free at both ends."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkplan.planner.problem.limits import within_reserve
from linkplan.planner.search.planning import plan_motion
from tests.support.bodies import body_problem

WINCH = """
<mujoco><default><geom contype="0" conaffinity="0"/></default>
  <worldbody><site name="top" pos="0 0 3"/>
    <body pos="0 0 1"><joint name="h" type="slide" axis="0 0 1"/><geom type="sphere" size="0.05" mass="10"/>
      <site name="hook"/></body>
  </worldbody>
  <tendon><spatial name="rope"><site site="top"/><site site="hook"/></spatial></tendon>
  <actuator><motor name="winch" tendon="rope" gear="-1" ctrlrange="40 300"/></actuator></mujoco>
"""
ENDS = st.one_of(st.floats(-1e3, 1e3), st.sampled_from([-np.inf, np.inf]))
RANGES = st.tuples(ENDS, ENDS).map(sorted).filter(lambda ends: ends[1] - ends[0] > 1e-3).map(lambda ends: np.array([ends]))
SHARES = st.floats(0.0, 0.99)


@given(RANGES, SHARES, SHARES)
def test_a_larger_reserve_leaves_a_range_within_that_of_a_smaller_one(effort, one, other):
    (low, high), (least, most) = (within_reserve(effort, share)[0] for share in sorted((one, other)))
    rounding = 1e-12 * np.abs(effort[np.isfinite(effort)]).max(initial=0.0)
    assert low - rounding <= least < most <= high + rounding


@given(RANGES, SHARES)
def test_a_reserve_is_free_at_both_ends_of_a_finite_range_in_equal_parts(effort, share):
    (low, high), (least, most) = effort[0], within_reserve(effort, share)[0]
    if np.isfinite(high - low):
        assert [least - low, high - most] == pytest.approx(2 * [share * (high - low) / 2], abs=1e-9)


@given(RANGES, SHARES)
def test_the_actuators_own_ranges_follow_from_those_of_plans(effort, share):
    again = within_reserve(within_reserve(effort, share), -share / (1 - share))
    np.testing.assert_allclose(again, effort, atol=1e-9, rtol=1e-9)


def test_a_rope_with_a_reserve_is_slower_and_tighter():
    def lifted(reserve: float):
        motion = 'kind = "reach"\nstart_m = { h = -0.5 }\ngoal_m = { h = 1.0 }\nduration_s = "free"\n'
        plan = plan_motion(body_problem(WINCH, motion, 'objective.minimize="time"', f"limits.reserve={reserve}"))
        assert plan.status == "optimal", plan.message
        return plan

    plans = [lifted(reserve) for reserve in (0.0, 0.05, 0.25)]
    # Two phases of constant acceleration: t = sqrt(2 d (1/a + 1/b)) with a = F/m - g up, b = g - f/m down.
    for plan, (least, most) in zip(plans, ((40.0, 300.0), (46.5, 293.5), (72.5, 267.5)), strict=True):
        up, down = most / 10.0 - 9.81, 9.81 - least / 10.0
        assert plan.duration_s == pytest.approx(np.sqrt(2 * 1.5 * (1 / up + 1 / down)), rel=1e-6)
        efforts = plan.trajectory.effort_at(plan.trajectory.dense_times())
        assert [efforts.min(), efforts.max()] == pytest.approx([least, most], rel=1e-4)
