"""Large signals: the describing function beside python-control's, and the feasible-amplitude curve beside exact ones."""

import control
import numpy as np
import pytest

from linkplan.controllers.sampling import sampling
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.feedback.frequency.describing import balance, large_signals, saturation
from linkplan.studies.feedback.frequency.feasible import feasible_curve
from linkplan.studies.feedback.frequency.feedback_loops import feedback_loop, law_gain, operating_point
from tests.support.fourbar import SHANK, knee
from tests.support.oscillators import inertia_alone, pendulum
from tests.support.tolerances_loops import NUMERICAL_SATURATION, ON_A_GRID, SATURATION, SMALL_COMMAND, UNSATURATED
from tests.support.tolerances_planner import ROUNDING

# Bisected to 1e-7; between 181 phases a peak is missed to second order. Measured 1e-7.
FEASIBLE = 1e-5
# The describing function of a command that is not quite a sine, relative; harmonic balance of a loop that is low-pass.
DESCRIBING, BALANCE_DB = 0.03, 0.35


def test_a_pure_inertia_follows_up_to_the_limit_over_its_inertia():
    mechanism = load_mechanism(inertia_alone(0.05, 3.0))
    point = operating_point(mechanism, np.zeros(1))
    amplitude = np.array([0.001, 0.1, 2.0])
    curve = feasible_curve(point, amplitude, mechanism.effort_limit)
    assert curve.frequency_hz == pytest.approx(np.sqrt(3.0 / (0.05 * amplitude)) / (2 * np.pi), rel=FEASIBLE)
    assert set(curve.reason) == {"effort of turn"}


def test_a_speed_limit_ends_the_curve_where_it_binds_first():
    mechanism = load_mechanism(inertia_alone(0.05, 3.0))
    point = operating_point(mechanism, np.zeros(1))
    curve = feasible_curve(point, np.array([2.0, 0.01]), mechanism.effort_limit, speed_limit=np.array([[-5.0, 5.0]]))
    assert curve.frequency_hz[0] == pytest.approx(5.0 / 2.0 / (2 * np.pi), rel=FEASIBLE)
    assert curve.reason[0] == "speed of h"
    assert curve.reason[1] == "effort of turn"


def test_an_amplitude_beyond_the_reach_cannot_be_followed_however_slowly():
    mechanism = load_mechanism("optimus-knee")
    point = operating_point(mechanism, np.radians([3.6]))
    curve = feasible_curve(point, np.radians([10.0, 89.0]), mechanism.effort_limit)
    assert curve.frequency_hz[0] > 100
    assert curve.frequency_hz[1] == 0


def test_a_pendulum_heavier_than_its_motor_at_the_end_of_the_swing_cannot_be_followed():
    oscillator = pendulum()
    mechanism = load_mechanism(oscillator.mjcf)
    point = operating_point(mechanism, np.array([0.0]))
    weight = 1.3 * 9.81 * 0.3
    limit = np.array([[-weight * np.sin(0.5), weight * np.sin(0.5)]])
    curve = feasible_curve(point, np.array([0.45, 0.55]), limit)
    assert curve.frequency_hz[0] > 0
    assert curve.frequency_hz[1] == 0


def test_the_shanks_curve_is_that_of_its_inverse_dynamics():
    mechanism = load_mechanism("optimus-knee", payload="shank")
    middle, amplitude = np.radians(3.6), np.radians(20.0)
    point = operating_point(mechanism, np.array([middle]))
    curve = feasible_curve(point, np.array([amplitude]), mechanism.effort_limit)
    # A second route: the four-bar's closed form, on a grid fine enough that its own peak is met.
    phase = np.linspace(0, 2 * np.pi, 2881)
    w = 2 * np.pi * curve.frequency_hz[0]
    s, v, a = middle + amplitude * np.cos(phase), -amplitude * w * np.sin(phase), -amplitude * w**2 * np.cos(phase)
    M, V = knee().carrying("crank", SHANK).fitted(s.min(), s.max())
    torque = M(s) * a + 0.5 * M.deriv()(s) * v**2 + V.deriv()(s)
    assert np.abs(torque).max() == pytest.approx(100.0, rel=ON_A_GRID)


@pytest.fixture(scope="module")
def loop():
    mechanism = load_mechanism("optimus-knee", payload="shank")
    point = operating_point(mechanism, np.radians([3.6]))
    gain = law_gain(point, "pd", Tracking(kp=200.0, kd=20.0), mechanism.effort_limit)
    return feedback_loop(point, gain, sampling(mechanism, 1e-4))


@pytest.fixture(scope="module")
def large(loop):
    limit = loop.point.mechanism.effort_limit
    return large_signals(loop, limit, np.array([25.0, 40.0]), multiples=(0.5, 1.3, 2.5))


@pytest.mark.slow
def test_below_the_limit_nothing_depends_on_the_amplitude(large, loop):
    small = loop.gains("reference", large.frequency_hz)
    assert np.abs(large.measured[:, 0] / small - 1).max() < UNSATURATED
    assert large.saturated[:, 0].max() == 0
    assert large.describing[:, 0] == pytest.approx(1.0, abs=SATURATION)


@pytest.mark.slow
def test_past_the_limit_the_measured_describing_function_is_the_saturations(large):
    past = large.saturated > 0.1
    assert past[:, 1:].all()
    assert np.abs(large.describing[past] / large.describing_predicted[past] - 1).max() < DESCRIBING
    assert large.describing_predicted[past].max() < 0.95


def test_past_the_limit_the_closed_loop_is_what_harmonic_balance_says(large):
    difference = 20 * np.log10(np.abs(large.measured / large.predicted))
    assert np.abs(difference).max() < BALANCE_DB
    drop = 20 * np.log10(np.abs(large.measured[:, 2] / large.measured[:, 0]))
    assert drop.max() < -4


def test_the_describing_function_is_python_controls_for_equal_limits_and_its_numerical_one_for_unequal(loop):
    hold = loop.point.hold[0]
    A = np.array([50.0, 120.0, 400.0])
    even = saturation(loop, np.array([[hold - 90.0, hold + 90.0]]))(A)
    exact = np.where(A > 90, 2 / np.pi * (np.arcsin(90 / A.clip(90)) + 90 / A * np.sqrt(1 - (90 / A.clip(90)) ** 2)), 1.0)
    assert even == pytest.approx(exact, rel=SATURATION)
    assert even == pytest.approx(
        np.real(control.describing_function(control.saturation_nonlinearity(90.0), A)), rel=ROUNDING
    )
    uneven = saturation(loop, np.array([[hold - 80.0, hold + 100.0]]))(A)
    numerical = control.describing_function(lambda x: min(max(x, -80.0), 100.0), A, num_points=4000)
    assert uneven == pytest.approx(np.real(numerical), rel=NUMERICAL_SATURATION)


def test_harmonic_balance_of_a_small_signal_is_the_linear_response(loop):
    N = saturation(loop, loop.point.mechanism.effort_limit)
    gain, command = balance(loop, "reference", 30.0, 1e-4, N)
    at = np.array([30.0])
    assert gain == pytest.approx(loop.gains("reference", at)[0], rel=SATURATION)
    assert command == pytest.approx(1e-4 * abs(loop.gains("control", at)[0]), rel=SMALL_COMMAND)


def test_an_actuator_without_a_limit_has_no_saturation(loop):
    with pytest.raises(LinkplanError, match="no effort limit"):
        saturation(loop, np.array([[-np.inf, np.inf]]))
