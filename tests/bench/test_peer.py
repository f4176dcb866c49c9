"""The yardsticks of `make bench` are themselves right, used well, and show what they are kept for."""

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import close_at
from tests.bench import packages
from tests.bench.__main__ import between_nodes
from tests.bench.opti_peer import acceleration_function, build_peer
from tests.support.tolerances_planner import TYPED_BY_HAND

ENDS = np.radians([-49.07, 56.27])
# The least effort, in which Opti and linkplan agree, the least time (tests/data/knee.json), and how far forty intervals may
# be from them.
LEAST = {0.16: 382.59, None: 0.12185126841421788}
APART = 1e-3
# One answer by two ways at IPOPT's tolerance.
SOLVED = 1e-8


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


def test_it_is_solved_again_from_its_multipliers_for_the_answer_of_a_fresh_one():
    peer, goal = build_peer(10, *ENDS, 0.16), np.radians(55.0)
    first = peer.solve(ENDS[1])
    again, fresh = peer.again(), build_peer(10, ENDS[0], goal, 0.16)
    asked = float(fresh.solve(goal).value(fresh.opti.f))
    assert abs(asked / float(first.value(peer.opti.f)) - 1) > APART
    assert again(goal) == pytest.approx(asked, rel=SOLVED)
    assert again(ENDS[1]) == pytest.approx(float(first.value(peer.opti.f)), rel=SOLVED)


@pytest.mark.slow
@pytest.mark.parametrize("duration", LEAST)
@pytest.mark.parametrize(("package", "solve"), [("rockit", packages.by_rockit), ("yapss", packages.by_yapss)])
def test_packages_solve_the_same_problem_and_again_for_another_goal(package, solve, duration):
    pytest.importorskip(package)
    answer = solve(duration)
    again = answer.again()
    assert answer.objective == pytest.approx(LEAST[duration], rel=APART)
    assert again(np.radians(55.0)) < (1 - APART) * answer.objective
    assert again(ENDS[1]) == pytest.approx(answer.objective, rel=SOLVED)
