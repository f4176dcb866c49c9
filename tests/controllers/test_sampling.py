"""The sampling of a control law against delays written out, held efforts in closed form, and its limits on both sides."""

import numpy as np
import pytest

from linkplan.controllers.sampling import Sampling, augmented, closed, sampling, simulated, spectral_radius
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism, load_mechanism
from tests.support.bodies import HINGE, HINGE_INERTIA

STEP_S = 0.002  # of the hinge's model
# A system of two states and one input; `EARLY` and `LATE` are the effects of the new and the previous command.
A = np.array([[1.0, 0.1], [-0.2, 0.9]])
EARLY, LATE = np.array([[0.3], [1.0]]), np.array([[0.05], [0.7]])


def hinge() -> Mechanism:
    return load_mechanism(HINGE)


@pytest.mark.parametrize(
    ("period_steps", "delay", "substeps", "delay_steps"),
    [
        (1, 0.0, 1, 0),
        (1, 1.0, 1, 1),
        (2.5, 0.0, 3, 0),
        (2.5, 0.5, 4, 2),
        (3, 0.3, 10, 3),
        (5, 1.2, 5, 6),
        (0.1, 0.05, 20, 1),
    ],
)
def test_a_period_has_the_fewest_steps_that_the_model_and_the_delay_allow(period_steps, delay, substeps, delay_steps):
    found = sampling(hinge(), period_steps * STEP_S, delay)
    assert (found.substeps, found.delay_steps) == (substeps, delay_steps)
    assert found.timestep_s <= STEP_S * (1 + 1e-9)
    assert found.delay_s == pytest.approx(delay * found.period_s)


def test_a_delay_is_whole_periods_and_steps_of_the_next():
    found = Sampling(period_s=0.01, substeps=4, delay_steps=11)
    assert (found.whole, found.late, found.memory) == (2, 3, 3)
    assert Sampling(period_s=0.01, substeps=4, delay_steps=8).memory == 2
    assert found.delay_s == pytest.approx(0.0275)
    assert found.nyquist_hz == pytest.approx(50.0)


@pytest.mark.parametrize(("beyond", "accepted"), [(3e-7, True), (3e-6, False), (0.0246, False)])
def test_a_delay_between_two_steps_is_refused_unless_by_rounding(beyond, accepted):
    for sign in (1, -1):
        delay = 0.5 + 0.5 * sign * beyond
        if accepted:
            assert sampling(hinge(), STEP_S, delay).delay_steps == 1
        else:
            with pytest.raises(LinkplanError, match="not a whole number of simulator steps"):
                sampling(hinge(), STEP_S, delay)


def test_a_period_of_a_hundred_thousand_steps_is_the_longest():
    assert sampling(hinge(), 1e5 * STEP_S).substeps == 100_000
    with pytest.raises(LinkplanError, match="at most 100000 are run"):
        sampling(hinge(), 1.01e5 * STEP_S)


@pytest.mark.parametrize("delay_steps", [0, 1, 2, 3, 4, 7])
def test_the_state_with_past_commands_moves_as_the_delayed_commands_say(delay_steps):
    timing = Sampling(period_s=1.0, substeps=2, delay_steps=delay_steps)
    late = LATE if timing.late else 0 * LATE
    command = np.random.default_rng(0).normal(size=20)
    whole, memory = delay_steps // 2, timing.memory
    wide_A, wide_B = augmented(A, EARLY, late, timing)
    x, wide = np.zeros(2), np.zeros(2 + memory)
    for k, u in enumerate(command):
        acting = [command[i] if i >= 0 else 0.0 for i in (k - whole, k - whole - 1)]
        x = A @ x + EARLY[:, 0] * acting[0] + late[:, 0] * acting[1]
        wide = wide_A @ wide + wide_B[:, 0] * u
        assert wide[:2] == pytest.approx(x, abs=1e-12)
        assert wide[2:] == pytest.approx([command[k - i] if k >= i else 0.0 for i in range(memory)], abs=1e-12)


def test_a_command_that_comes_late_moves_an_inertia_by_both_commands_shares():
    """J s'' = u over a period T, u the old command until c and then the new one: v = (c u_old + (T - c) u_new) / J."""
    timing = Sampling(period_s=0.01, substeps=4, delay_steps=1)
    T, c, J = 0.01, 0.0025, HINGE_INERTIA
    state = np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1))
    motion, new, old = (of_all[0] for of_all in simulated(hinge(), *state, timing))
    assert motion == pytest.approx(np.array([[1.0, T], [0.0, 1.0]]))
    assert new[1, 0] == pytest.approx((T - c) / J)
    assert old[1, 0] == pytest.approx(c / J)


def test_a_closed_loop_feeds_back_the_measured_state_only():
    timing = Sampling(period_s=1.0, delay_steps=1)
    wide_A, wide_B = augmented(A, EARLY, 0 * EARLY, timing)
    gain = np.array([[0.4, 0.2]])
    loop = closed(wide_A, wide_B, gain)
    state = np.array([1.0, -2.0, 0.5])
    assert loop @ state == pytest.approx([*(A @ state[:2] + EARLY[:, 0] * 0.5), -(gain @ state[:2])[0]])


def test_a_spectral_radius_is_the_largest_size_of_an_eigenvalue():
    assert spectral_radius(np.array([np.diag([0.5, -0.9]), [[0.0, -4.0], [1.0, 0.0]]])) == pytest.approx([0.9, 2.0])
