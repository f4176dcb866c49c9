"""The hand-written yardstick of `make bench` is itself right, and shows what it is kept for."""

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import close_at
from tests.bench.__main__ import between_nodes
from tests.bench.opti_peer import acceleration_function, build_peer
from tests.support.tolerances_planner import TYPED_BY_HAND

ENDS = np.radians([-49.07, 56.27])


def test_the_closed_form_typed_by_hand_is_the_reduced_model():
    mechanism, by_hand = load_mechanism("optimus-knee", payload="shank"), acceleration_function()
    for s in np.linspace(-1.2, 1.2, 9):
        pose = close_at(mechanism, np.array([s]))
        assert float(by_hand(s, 3.0, 50.0)) == pytest.approx(
            float(mechanism.dynamics.acceleration(pose, 3.0, 50.0)), rel=TYPED_BY_HAND
        )


def test_its_least_time_rests_on_torque_beyond_the_limit_between_nodes():
    peer = build_peer(40, *ENDS, None)
    solution = peer.solve(ENDS[1])
    torque = np.array(solution.value(peer.effort)).reshape(-1)
    assert np.abs(torque).max() <= 100.0 + 1e-5
    assert between_nodes(torque) > 101.0
