"""Transfer functions and margins against the textbook and python-control."""

from collections.abc import Callable

import control
import numpy as np
import pytest
import scipy.linalg

from linkplan.controllers.sampling import Sampling
from linkplan.models.mechanism import load_mechanism
from linkplan.studies.feedback.frequency.feedback_loops import CONTINUOUS, FeedbackLoop, feedback_loop, operating_point
from linkplan.studies.feedback.frequency.margins import Margins, margins
from linkplan.studies.feedback.frequency.transfer_function import in_right_half_plane, transfer_function
from tests.support.oscillators import inertia_alone

FREQUENCY_HZ = np.geomspace(0.05, 50.0, 9)


def chain(masses, stiffness, damping):
    """Return A and b of masses in a row with springs and dampers between them, pushed at the first one."""
    n = len(masses)
    K = np.zeros((n, n))
    for i, k in enumerate(stiffness):
        K[i : i + 2, i : i + 2] += k * np.array([[1, -1], [-1, 1]])
    inverse = np.diag(1 / np.array(masses))
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K, -damping * inverse @ K]])
    return A, np.concatenate([np.zeros(n), inverse[0]])


def at_mass(k, n):
    return np.eye(2 * n)[k]


def upper(roots):
    """Return roots in order, each pair once."""
    return np.sort_complex(roots[roots.imag >= 0])


def test_two_masses_have_the_textbooks_response_to_the_pushed_and_to_the_other_mass():
    m1, m2, k = 2.0, 3.0, 500.0
    A, b = chain([m1, m2], [k], 0.0)
    s = 2j * np.pi * FREQUENCY_HZ
    swings, stands = k * (1 / m1 + 1 / m2), k / m2
    own, other = (transfer_function(A, b, at_mass(j, 2)) for j in (0, 1))
    assert own.at(FREQUENCY_HZ) == pytest.approx((s**2 + stands) / (m1 * s**2 * (s**2 + swings)), rel=1e-10)
    assert other.at(FREQUENCY_HZ) == pytest.approx(k / (m1 * m2 * s**2 * (s**2 + swings)), rel=1e-10)
    assert np.abs(own.zeros) == pytest.approx(np.sqrt(stands), rel=1e-12)
    assert len(other.zeros) == 0
    assert other.relative_degree == 4
    for one in (own, other):
        assert np.abs(one.poles[2:]) == pytest.approx(np.sqrt(swings), rel=1e-12)
        assert one.integrators == 2
        assert one.low_frequency_gain == pytest.approx(1 / (m1 + m2), rel=1e-12)


@pytest.mark.parametrize("n", [2, 3, 5, 8])
def test_no_spring_of_a_chain_adds_a_zero_at_the_far_end_whatever_the_coordinates(n):
    """The pencil's infinite eigenvalues come out finite here; the chain has no finite zero at all."""
    drawn = np.random.default_rng(n)
    A, b = chain(drawn.uniform(1, 3, n), drawn.uniform(100, 1000, n - 1), 0.0)
    turn = np.linalg.qr(drawn.normal(size=(n, n)))[0]
    T = scipy.linalg.block_diag(turn, turn)
    found = transfer_function(T @ A @ T.T, T @ b, at_mass(n - 1, n) @ T.T)
    assert (len(found.poles), len(found.zeros), found.integrators) == (2 * n, 0, 2)
    direct = [at_mass(n - 1, n) @ np.linalg.solve(2j * np.pi * f * np.eye(2 * n) - A, b) for f in FREQUENCY_HZ]
    assert found.at(FREQUENCY_HZ) == pytest.approx(np.array(direct), rel=1e-6)


def test_zeros_are_the_finite_eigenvalues_of_the_pencil_and_those_of_python_control():
    drawn, compared = np.random.default_rng(3), 0
    for _ in range(20):
        A, b, c = drawn.normal(size=(6, 6)), drawn.normal(size=6), drawn.normal(size=6)
        found = transfer_function(A, b, c)
        pencil = np.block([[A, b[:, None]], [c[None], np.zeros((1, 1))]])
        finite = scipy.linalg.eigvals(pencil, scipy.linalg.block_diag(np.eye(6), 0.0))
        finite = finite[np.isfinite(finite) & (np.abs(finite) < 1e6)]
        theirs = control.ss(A, b[:, None], c[None], 0).zeros()
        for others in (finite, theirs):
            assert upper(found.zeros) == pytest.approx(upper(others), rel=1e-7)
        assert upper(found.poles) == pytest.approx(upper(np.linalg.eigvals(A)), rel=1e-9)
        compared += len(in_right_half_plane(found.zeros))
    assert compared > 5


def test_modes_that_are_not_excited_cancel_and_leave_the_others_alone():
    A, b = chain([2.0, 3.0], [500.0], 1e-3)
    apart = np.array([[0.0, 1.0], [-49.0, -0.2]])
    whole, push, seen = scipy.linalg.block_diag(A, apart), np.append(b, [0.0, 0.0]), np.append(at_mass(1, 2), [0.0, 0.0])
    alone, beside = transfer_function(A, b, at_mass(1, 2)), transfer_function(whole, push, seen)
    assert beside.poles == pytest.approx(alone.poles, abs=1e-9)
    assert beside.zeros == pytest.approx(alone.zeros, rel=1e-9)
    assert alone.zeros == pytest.approx([-1e3], rel=1e-9)  # the damper and the spring between the masses: -k / d


def test_an_output_that_the_input_does_not_move_has_no_gain_and_no_poles():
    A, b = chain([2.0, 3.0], [500.0], 0.0)
    apart = scipy.linalg.block_diag(A, np.array([[0.0, 1.0], [-49.0, -0.2]]))
    nothing = transfer_function(apart, np.append(b, [0.0, 0.0]), np.eye(6)[4])
    assert (nothing.gain, len(nothing.poles), len(nothing.zeros)) == (0.0, 0, 0)
    assert not nothing.at(FREQUENCY_HZ).any()


@pytest.mark.parametrize("n_zeros", [1, 2, 3, 4])
def test_zeros_at_the_origin_are_there_though_rounding_splits_them(n_zeros):
    """s^m / ((s^2 - 30) (s^2 + 2 s + 70) (s^2 + 100)), as the internal torque of a leg on a wheel moves it along: s^2."""
    poles = np.concatenate([np.sqrt([30.0]), -np.sqrt([30.0]), np.roots([1, 2, 70]), [10j, -10j]])
    companion = scipy.linalg.companion(np.real(np.poly(poles)))
    turn = np.linalg.qr(np.random.default_rng(n_zeros).normal(size=(6, 6)))[0]
    numerator = np.eye(6)[5 - n_zeros]
    found = transfer_function(turn @ companion @ turn.T, turn[:, 0], numerator @ turn.T)
    assert np.array_equal(found.zeros, np.zeros(n_zeros))
    assert found.integrators == -n_zeros
    assert found.low_frequency_gain == pytest.approx(1 / np.real(np.prod(poles)), rel=1e-7)


CROSSOVER_HZ = 5.0


def of_response(response: Callable[[np.ndarray], np.ndarray]) -> Margins:
    """Return the margins of a stable loop with an open-loop response L(f), f in Hz."""
    point = operating_point(load_mechanism(inertia_alone(1.0, 1.0)), np.zeros(1))
    loop = feedback_loop(point, np.ones((1, 2)), Sampling(period_s=1e-3), CONTINUOUS)
    assert loop.stable
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FeedbackLoop, "gains", lambda _loop, _quantity, f, _channel: response(np.asarray(f, dtype=float)))
        return margins(loop)


@pytest.mark.parametrize("margin_rad", [0.5, -0.5])
def test_the_delay_margin_is_the_lag_that_takes_the_phase_to_minus_180_deg(margin_rad):
    """A phase beyond -180 deg, of a loop that is stable all the same, comes back to it after nearly a whole turn."""
    found = of_response(lambda f: CROSSOVER_HZ / f * np.exp(-1j * (np.pi - margin_rad)))
    lag = margin_rad % (2 * np.pi)
    assert found.phase_margin_deg == pytest.approx(np.degrees(margin_rad), rel=1e-9)
    assert found.delay_margin_s == pytest.approx(lag / (2 * np.pi * CROSSOVER_HZ), rel=1e-9)


def test_of_several_crossings_of_the_real_axis_the_nearest_ones_bound_the_gain():
    """L = -(4 / f) exp(0.3 i sin(pi (log2 f + 0.1))) is real at f = 2^(k - 0.1): |L| = 4 2^0.1 / 2^k."""
    found = of_response(lambda f: -4.0 / f * np.exp(0.3j * np.sin(np.pi * (np.log2(f) + 0.1))))
    at = 4.0 * 2**0.1 / 2.0 ** np.arange(-5, 8)
    assert found.gain_margin_db == pytest.approx(-20 * np.log10(at[at < 1].max()), rel=1e-6)
    assert found.gain_reduction_margin_db == pytest.approx(20 * np.log10(at[at > 1].min()), rel=1e-6)
