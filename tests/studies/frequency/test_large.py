"""Large signals, and Floquet's multipliers along periodic motions."""

from dataclasses import replace

import control
import numpy as np
import pytest

from linkplan.controllers.reference import sample
from linkplan.controllers.sampling import sampling
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.problem.settings import Tracking
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.compare.compare import build_tracker
from linkplan.studies.feedback.bode.further_studies import along_motion
from linkplan.studies.feedback.frequency.describing import balance, large_signals, saturation
from linkplan.studies.feedback.frequency.feasible import feasible_curve
from linkplan.studies.feedback.frequency.feedback_loops import feedback_loop, law_gain, operating_point
from linkplan.studies.feedback.frequency.floquet import floquet, frozen_radii, linear_law
from tests.support.fourbar import SHANK, knee
from tests.support.oscillators import inertia_alone, pendulum
from tests.support.refusals import assert_refused
from tests.support.tolerances_loops import (
    DECAY,
    LIOUVILLE,
    NUMERICAL_SATURATION,
    ON_A_GRID,
    SATURATION,
    SMALL_COMMAND,
    UNSATURATED,
)
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
    assert_refused(lambda: saturation(loop, np.array([[-np.inf, np.inf]])), "no effort limit")


@pytest.fixture(scope="module")
def plan():
    return plan_motion(load_problem("knee-sine"))


def along(plan, law, **settings):
    """Return the multipliers of a tracker of the plan with its settings changed."""
    problem = plan.problem.varied(tracking=plan.problem.tracking.replace(**settings))
    plan = replace(plan, problem=problem)
    tracking, mechanism = problem.tracking, problem.mechanism
    reference = sample(mechanism, plan.trajectory, tracking.period_s, plan.trajectory.duration_s)
    timing = sampling(mechanism, tracking.period_s, tracking.delay_periods)
    tracker = build_tracker(law, plan, reference)
    return floquet(mechanism, reference, tracker, timing, problem.limits.effort), reference, tracker, timing


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "settings"),
    [
        ("pd+ff", {"kp": 2.0, "kd": 0.005}),
        ("pd+ff", {"kp": 0.5, "kd": 0.002}),
        ("pd+ff", {"kp": 1.0, "kd": 0.006, "delay_periods": 2}),
        ("pd", {"kp": 2.0, "kd": 0.005}),
        ("pd", {"kp": 0.5, "kd": 0.002}),
    ],
)
def test_multipliers_predict_the_decay_a_cycle_leaves_in_mujoco(plan, law, settings):
    found, *_ = along(plan, law, **settings)
    predicted, measured = found.multiplier_size[:2], found.measured_multiplier_size[:2]
    assert 1e-4 < predicted[0] < 0.9
    assert measured == pytest.approx(predicted, rel=DECAY)
    assert found.converges


@pytest.mark.slow
@pytest.mark.parametrize("law", ["pd", "pd+ff", "lqr"])
def test_the_problems_own_trackers_let_a_disturbance_die_as_predicted(plan, law):
    found, *_ = along(plan, law)
    assert found.log_left_predicted < np.log(1e-4)
    assert found.log_left_measured == pytest.approx(found.log_left_predicted, rel=DECAY)
    assert 0 < found.seen_s <= found.cycle_s


@pytest.mark.slow
def test_determinant_of_the_monodromy_is_the_product_of_the_steps_determinants(plan):
    # Liouville: det A_k - B_k K_k of the joint with damping kd is 1 - kd T / J in MuJoCo's steps, whatever the motion.
    found, reference, *_ = along(plan, "pd+ff", kp=0.5, kd=0.002)
    mechanism = plan.problem.mechanism
    inertia = np.array([float(mechanism.dynamics.reduced_inertia(pose)) for pose in reference.pose_rad])
    slope = np.gradient(np.log(inertia), reference.position_rad[:, 0])
    # J s'' + J' / 2 s'^2 = u: the speed's own derivative of the acceleration is -J' / J s'.
    factor = 1 - reference.period_s * (0.002 / inertia + slope * reference.velocity_rad_s[:, 0])
    assert np.linalg.det(found.monodromy) == pytest.approx(np.prod(factor), rel=LIOUVILLE)


@pytest.mark.slow
def test_a_loop_that_is_stable_nowhere_along_the_motion_does_not_converge(plan):
    found, reference, tracker, timing = along(plan, "pd+ff", kp=200.0, kd=10.0)
    assert not found.converges
    assert frozen_radii(plan.problem.mechanism, reference, linear_law(tracker).gains, timing).min() > 1


@pytest.mark.slow
def test_a_motion_that_does_not_repeat_after_whole_periods_has_no_multipliers(plan):
    assert_refused(lambda: along(plan, "pd+ff", period_s=1.7e-4), "whole control periods")


@pytest.mark.slow
def test_the_loop_frozen_along_a_reach_has_margins_at_every_instant_and_no_multipliers():
    plan = plan_motion(load_problem("knee-reach"))
    found = along_motion(plan, "lqr", plan.problem.tracking)
    assert found.floquet is None
    assert all(bounds.stable for bounds in found.frozen)
    assert found.largest_frozen_pole < 1
    assert found.worst.disk_margin == min(bounds.disk_margin for bounds in found.frozen)
