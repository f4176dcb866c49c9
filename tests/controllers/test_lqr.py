"""Riccati recursions of scalar systems against their limits."""

import numpy as np
import pytest
import scipy.linalg

from linkplan.controllers.trackers.lqr import regulate
from linkplan.models.errors import GainError

# x+ = a x + b u over a cycle of three instants, with costs q x^2 + r u^2; feedback is weak, so that a cycle forgets slowly.
a, b, q, r = np.array([1.02, 0.97, 1.01]), np.array([0.2, 0.1, 0.15]), 0.05, 1.0


def scalar(repeats: bool, along=a, steered=b):
    return regulate(
        along[:, None, None], steered[:, None, None], np.array([[q]]), np.array([[r]]), repeats=repeats
    )  # fmt: skip


def endless(along: np.ndarray, steered: np.ndarray) -> float:
    """Return the cost at the beginning of endless cycles."""
    p = 1.0
    for _ in range(2000):
        for k in (2, 1, 0):
            p = q + along[k] ** 2 * p * r / (r + steered[k] ** 2 * p)
    return p


def test_costs_of_a_cycle_are_those_of_endless_cycles():
    """A cycle multiplies a change of the cost at its end by a factor c: the rest of the recursion adds c / (1 - c) of it."""
    found, p = scalar(repeats=True), endless(a, b)
    c = float(np.prod((a - b * found.gains[:, 0, 0]) ** 2))
    assert 0.3 < c < 0.9
    assert found.cost[0, 0, 0] == pytest.approx(p, rel=1e-9 * c / (1 - c))
    assert abs(scalar(repeats=False).cost[0, 0, 0] / p - 1) > 1e-3  # the end's own cost is another one


def test_costs_of_states_that_do_not_touch_each_other_are_their_own():
    """The second one needs some 160 cycles to converge, and more than 200 to the last bit."""
    weak = 0.55 * b
    A, B = (np.array([np.diag([x, y]) for x, y in zip(*pair, strict=True)]) for pair in ((a, a), (b, weak)))
    found = regulate(A, B, q * np.eye(2), r * np.eye(2), repeats=True)
    assert np.diag(found.cost[0]) == pytest.approx([endless(a, b), endless(a, weak)], rel=1e-8)
    assert found.cost[0, 0, 1] == pytest.approx(0.0, abs=1e-12)


def test_a_cycle_that_forgets_too_slowly_is_refused():
    """Feedback as weak as this needs some 500 cycles."""
    with pytest.raises(GainError, match="no gain that repeats"):
        scalar(repeats=True, steered=0.2 * b)


def test_a_motion_that_ends_has_the_stationary_cost_at_its_end():
    found = scalar(repeats=False)
    end = scipy.linalg.solve_discrete_are(a[-1:, None], b[-1:, None], [[q]], [[r]])[0, 0]
    assert found.cost[-1, 0, 0] == pytest.approx(end, rel=1e-9)
    for k in (1, 0):
        later = found.cost[k + 1, 0, 0]
        assert found.cost[k, 0, 0] == pytest.approx(q + a[k] ** 2 * later * r / (r + b[k] ** 2 * later), rel=1e-12)


@pytest.mark.parametrize(("repeats", "after"), [(True, [1, 2, 0]), (False, [1, 2, 2])])
def test_the_last_instant_is_followed_by_the_first_of_a_cycle_or_by_itself(repeats, after):
    assert scalar(repeats=repeats).after.tolist() == after


@pytest.mark.parametrize("repeats", [True, False])
def test_what_grows_without_an_effort_that_acts_has_no_gain(repeats):
    with pytest.raises(GainError, match="no stabilising gain"):
        scalar(repeats, steered=0 * b, along=1.1 * np.ones(3))
