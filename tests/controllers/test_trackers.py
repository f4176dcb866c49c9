"""Trackers: laws against their formulas, held dynamics, Riccati's recursions, predictions along the motion ahead."""

from functools import cache

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from linkplan.controllers.linearisation import discretise, linearise
from linkplan.controllers.reference import SampledReference, pose_advance, sample, state_at
from linkplan.controllers.trackers.lqr import lqr, regulate
from linkplan.controllers.trackers.pd import pd
from linkplan.controllers.trackers.prediction import condensing, predictor
from linkplan.models.errors import GainError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.planner.trajectory import Trajectory
from linkplan.studies.compare.compare import build_tracker
from tests.support.bodies import HINGE, HINGE_INERTIA
from tests.support.designs import designed
from tests.support.fourbar import SHANK, knee
from tests.support.motions import motion_along
from tests.support.plans import optimal
from tests.support.references import PERIOD, hinge_reference, reference_of
from tests.support.tolerances_planner import EXPONENTIAL, GAINS, ROUNDING, SAME_FIGURE

TRACKERS = ("pd", "pd+ff", "lqr")


@cache
def tracker_of(kind: str, name: str = "knee-reach"):
    return build_tracker(kind, optimal(name), reference_of(name))


# The sampled reference.


@pytest.mark.slow
@pytest.mark.parametrize("name", ["knee-reach", "knee-sine-shank"])
def test_a_reference_is_the_trajectory_at_the_control_instants(name):
    reference, trajectory = reference_of(name, PERIOD, 0.4), optimal(name).trajectory
    assert reference.n == 400
    np.testing.assert_allclose(reference.time_s, PERIOD * np.arange(400), rtol=ROUNDING)
    # What repeats is sampled once; the second cycle's times differ from the first's by the rounding of a long sum.
    position, velocity = trajectory.position_at(reference.time_s), trajectory.velocity_at(reference.time_s)
    np.testing.assert_allclose(reference.position_rad, position, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(reference.velocity_rad_s, velocity, rtol=ROUNDING, atol=ROUNDING * np.abs(velocity).max())


def test_a_reference_s_effort_is_the_inverse_dynamics_in_the_middle_of_each_hold():
    reference, trajectory = reference_of("knee-reach"), optimal("knee-reach").trajectory
    middle = reference.time_s + PERIOD / 2
    s, v, a = (f(middle)[:, 0] for f in (trajectory.position_at, trajectory.velocity_at, trajectory.acceleration_at))
    M, V = knee().carrying("crank", SHANK).fitted(s.min(), s.max())
    np.testing.assert_allclose(reference.effort[:, 0], M(s) * a + 0.5 * M.deriv()(s) * v**2 + V.deriv()(s), rtol=SAME_FIGURE)


def test_a_reference_that_reaches_its_goal_rests_there():
    reference = reference_of("knee-reach", PERIOD, 0.3)
    after = reference.time_s > 0.16
    np.testing.assert_array_equal(reference.velocity_rad_s[after], 0)
    assert np.ptp(reference.position_rad[after]) == 0
    weight = knee().carrying("crank", SHANK).fitted(0.9, 1.0)[1].deriv()(reference.position_rad[-1, 0])
    assert abs(weight) > 0.1
    np.testing.assert_allclose(reference.effort[after], weight, rtol=SAME_FIGURE)


@pytest.mark.parametrize(
    ("name", "period", "cycle"),
    [("knee-sine-shank", 1e-3, 250), ("knee-sine-shank", 1.1e-3, None), ("knee-reach", 1e-3, None)],
)
def test_a_reference_repeats_after_whole_periods_only(name, period, cycle):
    assert reference_of(name, period, 0.1).cycle == cycle


# The laws.


def test_pd_is_the_gains_times_the_errors():
    tracker, reference = tracker_of("pd"), reference_of("knee-reach")
    effort = tracker.effort(40, reference.position_rad[40] - 0.01, reference.velocity_rad_s[40] + 0.3)
    assert effort == pytest.approx(200 * 0.01 - 20 * 0.3)


def test_pd_goes_through_the_gear_to_the_motor():
    geared = load_mechanism(HINGE.replace("<motor ", '<motor gear="-2.5" '))
    tracker = pd(geared, hinge_reference(geared), 10.0, 2.0)
    assert tracker.effort(0, np.array([-0.1]), np.array([0.0])) == pytest.approx(10 * 0.1 / -2.5)


def test_feedforward_adds_the_reference_s_own_effort():
    reference = reference_of("knee-reach")
    state = reference.position_rad[7] + 0.02, reference.velocity_rad_s[7] - 0.1
    expected = reference.effort[7] + tracker_of("pd").effort(7, *state)
    np.testing.assert_array_equal(tracker_of("pd+ff").effort(7, *state), expected)


def test_lqr_is_the_gains_times_the_state_s_error():
    tracker, reference = tracker_of("lqr"), reference_of("knee-reach")
    effort = tracker.effort(30, reference.position_rad[30] - 0.01, reference.velocity_rad_s[30] + 0.2)
    gains = tracker.gains[30, 0]
    assert effort - reference.effort[30] == pytest.approx(gains[0] * 0.01 - gains[1] * 0.2)


@pytest.mark.parametrize("kind", TRACKERS)
@settings(derandomize=True, deadline=None, max_examples=25)
@given(st.lists(st.integers(0, 159), min_size=2, max_size=6), st.floats(-1.5, 1.5), st.floats(-100, 100))
def test_a_tracker_is_a_pure_law(kind, instants, position, velocity):
    tracker = tracker_of(kind)
    s, v = np.array([position]), np.array([velocity])
    s.flags.writeable = v.flags.writeable = False
    first = [tracker.effort(k, s, v) for k in instants]
    again = [tracker.effort(k, s, v) for k in reversed(instants)][::-1]
    np.testing.assert_array_equal(first, again)
    assert (s[0], v[0]) == (position, velocity)


# Linearisation and hold.


@pytest.mark.parametrize("period", [1e-4, 0.1, 2.0])
def test_a_held_double_integrator_has_its_closed_form(period):
    A, B = discretise(np.array([[[0.0, 1.0], [0.0, 0.0]]]), np.array([[[0.0], [2.5]]]), period)
    np.testing.assert_allclose(A[0], [[1, period], [0, 1]], rtol=EXPONENTIAL)
    np.testing.assert_allclose(B[0, :, 0], [2.5 * period**2 / 2, 2.5 * period], rtol=EXPONENTIAL)


def test_a_held_pendulum_has_its_closed_form():
    rate, period = 3.0, 0.2
    A, B = discretise(np.array([[[0.0, 1.0], [-(rate**2), 0.0]]]), np.array([[[0.0], [1.0]]]), period)
    cos, sin = np.cos(rate * period), np.sin(rate * period)
    np.testing.assert_allclose(A[0], [[cos, sin / rate], [-rate * sin, cos]], rtol=ROUNDING)
    np.testing.assert_allclose(B[0, :, 0], [(1 - cos) / rate**2, sin / rate], rtol=ROUNDING)


# LQR's gains.


def test_the_gains_of_a_pure_inertia_are_scipy_s_stationary_ones():
    hinge = load_mechanism(HINGE)
    tracker = lqr(designed(hinge, hinge_reference(hinge), (0.02, 0.5, np.array([4.0]))))
    A = np.array([[1.0, 0.01], [0.0, 1.0]])
    B = np.array([[0.01**2 / 2], [0.01]]) / HINGE_INERTIA
    Q, R = np.diag([0.02**-2, 0.5**-2]), np.array([[4.0**-2]])
    P = scipy.linalg.solve_discrete_are(A, B, Q, R)
    gain = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    assert tracker.gains.shape == (50, 1, 2)
    np.testing.assert_allclose(tracker.gains, np.broadcast_to(gain, (50, 1, 2)), rtol=GAINS)


def knee_matrices(name: str) -> tuple[np.ndarray, ...]:
    plan, reference = optimal(name), reference_of(name)
    tracking = plan.problem.tracking
    A, B = discretise(
        *linearise(plan.problem.mechanism, reference.pose_rad, reference.velocity_rad_s, reference.effort),
        reference.period_s,
    )
    Q = np.diag(np.concatenate(tracking.lqr_errors(plan.problem.mechanism.independent_joints)) ** -2)
    return A, B, Q, np.array([[plan.problem.limits.effort[0, 1] ** -2]])


def test_the_gains_of_a_motion_obey_the_riccati_recursion_from_the_stationary_end():
    A, B, Q, R = knee_matrices("knee-reach")
    P = scipy.linalg.solve_discrete_are(A[-1], B[-1], Q, R)
    expected = np.empty((len(A), 1, 2))
    for k in range(len(A) - 1, -1, -1):
        closed = B[k].T @ P
        expected[k] = np.linalg.inv(R + closed @ B[k]) @ closed @ A[k]
        free = A[k] - B[k] @ expected[k]
        P = Q + expected[k].T @ R @ expected[k] + free.T @ P @ free  # Joseph's form of the same step
    np.testing.assert_allclose(tracker_of("lqr").gains, expected, rtol=GAINS)


def test_the_gains_of_a_periodic_motion_repeat_with_it():
    plan, reference = optimal("knee-sine-shank"), reference_of("knee-sine-shank", PERIOD, 0.6)
    gains = build_tracker("lqr", plan, reference).gains
    assert reference.cycle == 250
    assert len(gains) == 600
    assert np.all(np.ptp(gains[:250], axis=0) > 1e-4 * gains.mean(axis=0))  # they do change within a cycle
    np.testing.assert_array_equal(gains[250:500], gains[:250])
    np.testing.assert_array_equal(gains[500:], gains[:100])


@pytest.mark.slow
def test_the_gains_of_a_periodic_motion_are_those_of_a_long_recursion():
    A, B, Q, R = knee_matrices("knee-sine-shank")
    P = 7.0 * Q  # wherever it starts, the recursion forgets it
    for _ in range(40):
        gains = np.empty((len(A), 1, 2))
        for k in range(len(A) - 1, -1, -1):
            closed = B[k].T @ P
            gains[k] = np.linalg.solve(R + closed @ B[k], closed @ A[k])
            P = Q + A[k].T @ P @ (A[k] - B[k] @ gains[k])
    np.testing.assert_allclose(tracker_of("lqr", "knee-sine-shank").gains, gains, rtol=GAINS)


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


@pytest.mark.parametrize("steered", [b, 0.2 * b, b * [1, 1, 0]], ids=["strong", "weak", "not at its end"])
def test_costs_of_a_cycle_are_those_of_endless_cycles(steered):
    found, p = scalar(repeats=True, steered=steered), endless(a, steered)
    assert found.cost[0, 0, 0] == pytest.approx(p, rel=1e-12)
    assert found.gains[2, 0, 0] == pytest.approx(a[2] * steered[2] * p / (r + steered[2] ** 2 * p), rel=1e-12)


@pytest.mark.parametrize("repeats", [True, False])
def test_what_grows_without_an_effort_that_acts_has_no_gain(repeats):
    with pytest.raises(GainError, match="no stabilising gain"):
        scalar(repeats, steered=0 * b, along=1.1 * np.ones(3))


def stacked_program(A, B, e, w, Q, R, P) -> tuple[np.ndarray, np.ndarray]:
    """Return the Hessian and gradient of half of sum (e + dx)' Q (e + dx) + (w + d)' R (w + d) by one matrix for all dx."""
    blocks, m, n_u = len(A), A[0].shape[0], B[0].shape[1]
    way = np.zeros((blocks * m, blocks * n_u))
    for b in range(blocks):
        effect = B[b]
        for later in range(b, blocks):
            way[later * m : (later + 1) * m, b * n_u : (b + 1) * n_u] = effect
            effect = A[later + 1] @ effect if later + 1 < blocks else effect
    weight = scipy.linalg.block_diag(*[Q] * (blocks - 1), P)
    costs = np.kron(np.eye(blocks), R)
    return way.T @ weight @ way + costs, way.T @ weight @ e.T.ravel() + costs @ w.T.ravel()


@pytest.mark.parametrize(("blocks", "m", "n_u"), [(1, 2, 1), (3, 2, 1), (4, 3, 2)])
def test_the_condensed_program_is_that_of_stacked_matrices(blocks, m, n_u):
    draw = np.random.default_rng(blocks)
    A, B = draw.normal(size=(blocks, m, m)), draw.normal(size=(blocks, m, n_u))
    e, w = draw.normal(size=(m, blocks)), draw.normal(size=(n_u, blocks))
    Q, R, P = (x @ x.T for x in (draw.normal(size=(m, m)), draw.normal(size=(n_u, n_u)), draw.normal(size=(m, m))))
    hessian, gradient = condensing(blocks, m, n_u)(np.hstack(list(A)), np.hstack(list(B)), e, w, Q, R, P)
    expected = stacked_program(A, B, e, w, Q, R, P)
    assert np.array(hessian) == pytest.approx(expected[0], rel=1e-10, abs=1e-10)
    assert np.array(gradient).ravel() == pytest.approx(expected[1], rel=1e-10, abs=1e-10)


def test_a_prediction_is_along_the_corrected_motion_from_the_measured_state():
    """Two blocks: the error after each is the corrected step less the reference's, the slopes are half-way along it."""
    mechanism, block_s, kept = load_mechanism("optimus-knee"), 2e-3, np.array([0, 1])
    near = mechanism.home
    model = predictor(mechanism, kept, 2, block_s, "never")
    s, v = near[mechanism.independent] + 0.02, np.array([1.5])
    means, corrections = np.array([[3.0, -4.0]]), np.array([[30.0, -60.0]])
    begins = [np.append(near, 0.5)]
    begins.append(np.array(model.step(begins[0], means[:, 0])).ravel())
    owns = [begins[1], np.array(model.step(begins[1], means[:, 1])).ravel()]
    Q, R, P = np.diag([2.0, 0.5]), np.array([[0.3]]), np.diag([5.0, 1.0])
    hessian, gradient, gap = model.program(near, s, v, np.array(begins).T, means, np.array(owns).T, corrections, Q, R, P)
    assert float(gap) < 1e-9
    x, errors, A, B = np.append(close_at(mechanism, s, near), v), [], [], []
    for b in range(2):
        effort = means[:, b] + corrections[:, b]
        after = np.array(model.step(x, effort)).ravel()
        half = 0.5 * (x + after)
        block = np.zeros((3, 3))
        of_state, of_effort = linearise(mechanism, half[None, :-1], half[None, -1:], effort[None])
        block[:2, :2], block[:2, 2:] = of_state[0], of_effort[0]
        exponential = scipy.linalg.expm(block_s * block)
        A.append(exponential[:2, :2])
        B.append(exponential[:2, 2:])
        error = after - owns[b]
        errors.append([error[mechanism.independent[0]], error[-1]])
        x = begins[b + 1] + error if b == 0 else after
    expected = stacked_program(A, B, np.array(errors).T, corrections, Q, R, P)
    assert np.array(hessian) == pytest.approx(expected[0], rel=1e-7)
    assert np.array(gradient).ravel() == pytest.approx(expected[1], rel=1e-7)


SAMPLING_S = 0.01


def cubic_samples(n: int = 6) -> tuple[SampledReference, np.polynomial.Polynomial]:
    """Return n samples of a cubic in time, and the cubic."""
    path = np.polynomial.Polynomial([0.3, -2.0, 40.0, 700.0])
    time = SAMPLING_S * np.arange(n)
    reference = SampledReference(
        period_s=SAMPLING_S, time_s=time, pose_rad=path(time)[:, None], position_rad=path(time)[:, None],
        velocity_rad_s=path.deriv()(time)[:, None], effort=np.zeros((n, 1)), cycle=None,
    )  # fmt: skip
    return reference, path


def turning(start: float, periods: float) -> Trajectory:
    """Return a hinge's turn at constant speed from a start [rad], over a number of control periods."""
    return motion_along([0.0, periods * SAMPLING_S], start + np.array([0.0, 2 * np.pi]), periodic=True)


@pytest.mark.parametrize("at", [0.0, 0.4, 1.0, 2.75, 4.0, 4.99])
def test_between_samples_a_cubic_motion_is_itself(at):
    reference, path = cubic_samples()
    position, velocity = state_at(reference, at * SAMPLING_S)
    assert position == pytest.approx([path(at * SAMPLING_S)], abs=ROUNDING)
    assert velocity == pytest.approx([path.deriv()(at * SAMPLING_S)], abs=1e3 * ROUNDING)


@pytest.mark.parametrize("beyond", [0.5, 1.0, 3.25])
def test_after_the_last_sample_the_motion_goes_on_at_its_last_velocity(beyond):
    reference, _ = cubic_samples()
    last, speed = reference.position_rad[-1], reference.velocity_rad_s[-1]
    position, velocity = state_at(reference, reference.time_s[-1] + beyond * SAMPLING_S)
    assert position == pytest.approx(last + beyond * SAMPLING_S * speed, abs=ROUNDING)
    assert velocity == pytest.approx(speed, abs=1e3 * ROUNDING)


def test_a_turn_from_anywhere_advances_by_one_turn():
    mechanism = load_mechanism(HINGE)
    assert pose_advance(mechanism, turning(2.0, 4)) == pytest.approx([2 * np.pi])
    reference = sample(mechanism, turning(2.0, 4), SAMPLING_S, 10 * SAMPLING_S)
    assert reference.pose_rad[:, 0] == pytest.approx(2.0 + 0.5 * np.pi * np.arange(10), abs=1e-12)


def test_later_cycles_repeat_the_first_to_the_last_bit():
    """Trackers take their gains of a cycle once."""
    reference = sample(load_mechanism(HINGE), swinging(7), SAMPLING_S, 30 * SAMPLING_S)
    assert reference.cycle == 7
    for name in ("position_rad", "velocity_rad_s", "effort"):
        values = getattr(reference, name)
        assert np.ptp(values) > 0  # it moves
        assert np.array_equal(values[7:14], values[:7])
        assert np.array_equal(values[21:28], values[:7])


def swinging(periods: int) -> Trajectory:
    """Return a hinge's swing that begins and ends in one place at one speed."""
    duration = periods * SAMPLING_S
    position = np.array([0.0, 0.1, -0.1, 0.0]).reshape(4, 1, 1)
    return motion_along([0.0, duration], position, periodic=True)


@pytest.mark.parametrize(("ratio", "cycle"), [(7.0, 7), (7.0 + 1e-8, 7), (7.0 + 1e-4, None), (7.5, None)])
def test_a_cycle_is_a_whole_number_of_periods_but_for_rounding(ratio, cycle):
    assert sample(load_mechanism(HINGE), turning(0.0, ratio), SAMPLING_S, 20 * SAMPLING_S).cycle == cycle
