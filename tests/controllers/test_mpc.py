"""Model predictive control of a pure inertia: its horizon, what LQR alone would do, and when it takes over."""

import numpy as np
import pytest

from linkplan.controllers.trackers.mpc import HORIZON_BLOCKS, MPC, mpc
from linkplan.models.mechanism import load_mechanism
from tests.support.bodies import HINGE
from tests.support.designs import designed
from tests.support.references import hinge_reference


def hinge_mpc(horizon_periods: float = 1.0, limit: float = 4.0) -> MPC:
    mechanism = load_mechanism(HINGE)
    reference = hinge_reference(mechanism, 60)
    horizon_s = horizon_periods * HORIZON_BLOCKS * reference.period_s
    return mpc(designed(mechanism, reference, (0.02, 0.5, np.array([4.0])), limit, horizon_s=horizon_s))


@pytest.mark.parametrize(("horizon_periods", "block"), [(0.2, 1), (1.0, 1), (1.01, 2), (2.0, 2), (2.5, 3)])
def test_blocks_are_the_fewest_whole_periods_that_reach_the_horizon(horizon_periods, block):
    starts = hinge_mpc(horizon_periods).ahead[0]
    assert np.diff(np.minimum(starts, 59)).max() == block
    assert starts[1] == block


@pytest.mark.parametrize("block", [1, 3])
def test_what_lqr_alone_would_do_is_its_feedback_along_its_own_motion(block):
    law = hinge_mpc(block)
    A, B, K = law.regulator.A[0], law.regulator.B[0], law.regulator.gains[0]  # the same at all instants
    error = np.array([0.01, -0.2])
    corrections = law.alone[0] @ error
    for b in range(HORIZON_BLOCKS):
        assert corrections[b] == pytest.approx((-K @ error)[0], rel=1e-9, abs=1e-12)
        for _ in range(block):
            error = A @ error - B @ (K @ error)


@pytest.mark.parametrize(("share", "lqr_acts"), [(1.0, True), (1.0 + 1e-12, True), (1.0 + 1e-6, False)])
def test_lqr_acts_up_to_the_limit_but_for_rounding(share, lqr_acts):
    free = hinge_mpc(limit=1e6)
    position, velocity = np.array([[0.05]]), np.array([[0.3]])
    effort, _ = free.step(0, position, velocity, free.start(1))
    limit = float(np.abs(effort).max())
    assert np.abs(free.alone[0] @ [0.05, 0.3]).max() <= limit * (1 + 1e-12)  # the first effort is the largest
    law = hinge_mpc(limit=limit / share)
    found, memory = law.step(0, position, velocity, law.start(1))
    assert np.isnan(memory).all() == lqr_acts
    if lqr_acts:
        assert found[0, 0] == effort[0, 0]
    assert abs(found[0, 0]) <= limit * (1 + 1e-9)
