"""Limits that a motion overran are tightened by 1.1 times the overrun, others not; speeds from the second time on."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.closed_chain.case import case_of
from tests.support.margins import with_margin
from tests.support.plans import optimal


def test_a_range_and_a_speed_are_tightened_by_what_was_overrun():
    plan = optimal("knee-reach", "limits.speed_deg_s.A=1e4")
    n_q, before = plan.problem.mechanism.n_q, plan.problem.limits
    over = with_margin(plan.certificate, "position", 0, left=np.degrees(-0.01))
    over = with_margin(over, "speed", 1, left=np.degrees(-0.2))
    case = case_of(plan.problem)
    first = case.tightened(over, plan.trajectory)
    second = first.tightened(over, plan.trajectory)

    inward = np.array([1.0, -1.0])
    once = first.problem.limits
    assert once.position[0] == pytest.approx(before.position[0] + 1.1 * 0.01 * inward)
    np.testing.assert_array_equal(once.position[1:], before.position[1:])
    np.testing.assert_array_equal(once.speed, before.speed)
    bounded = replace(second, problem=replace(second.problem, limits=replace(once, speed=np.full((n_q, 2), [-9.0, 9.0]))))
    speeds = bounded.tightened(over, plan.trajectory).problem.limits.speed
    assert speeds[1] == pytest.approx([-9.0 + 1.1 * 0.2, 9.0 - 1.1 * 0.2])
    np.testing.assert_array_equal(speeds[[0, 2]], [[-9.0, 9.0], [-9.0, 9.0]])
