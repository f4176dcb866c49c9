"""Switch times and bang arcs, read from coefficients of efforts between limits of -5 and 5, from 10 s on."""

import numpy as np
import pytest

from linkplan.planner.refinement.switches import _pulse_in, _spread, find_bang_efforts, find_switch_times
from linkplan.planner.trajectory import Trajectory

LIMIT = np.array([[-5.0, 5.0]])


def motion(*coefficients: list[float], breaks: np.ndarray | None = None) -> Trajectory:
    """Return a motion at rest with the effort's coefficients (degree + 1, n) on intervals of a second."""
    effort = np.array(coefficients, dtype=float)[:, :, None]
    n = effort.shape[1]
    breaks = 10.0 + np.arange(n + 1.0) if breaks is None else breaks
    still = {"position": np.zeros((2, n, 1)), "velocity": np.zeros((1, n, 1)), "start_pose": np.zeros(1)}
    return Trajectory(breaks_s=breaks, effort=effort, periodic=False, **still)


@pytest.mark.parametrize(("smeared", "switches"), [(1, [11.5]), (3, [12.5]), (4, [11.0, 15.0])])
def test_up_to_three_intervals_between_two_limits_are_one_smeared_switch_and_more_an_arc(smeared, switches):
    found = find_switch_times(motion([5.0, *[0.0] * smeared, -5.0]), LIMIT)
    assert found == pytest.approx(switches)


@pytest.mark.parametrize(("first", "last"), [(5.0, -5.0), (-5.0, 5.0)])
def test_an_interval_in_which_the_effort_goes_from_one_limit_to_the_other_is_at_neither(first, last):
    found = find_switch_times(motion([first, first, last], [first, last, last]), LIMIT)
    assert found == pytest.approx([11.5])


@pytest.mark.parametrize("continuous", [False, True])
def test_efforts_without_jumps_leave_one_limit_and_come_to_the_other_at_the_ends_of_what_is_between(continuous):
    found = find_switch_times(motion([5.0, 1.0, -5.0]), LIMIT, continuous_efforts=continuous)
    assert found == pytest.approx([11.0, 12.0] if continuous else [11.6])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_arc_within_the_limits_begins_and_ends_where_the_impulse_of_its_first_and_last_interval_says(sign):
    """Along the arc the effort is 1: three tenths of its first interval are at 5, six tenths of its last at -5."""
    efforts = [5.0, 0.3 * 5 + 0.7 * 1, 1.0, 1.0, 1.0, 0.4 * 1 + 0.6 * -5, -5.0]
    found = find_switch_times(motion((sign * np.array(efforts)).tolist()), LIMIT)
    assert found == pytest.approx([11.3, 15.4])


def test_bang_efforts_are_those_between_the_switches_of_each_segment():
    found = find_bang_efforts(motion([5.0, 2.0, -5.0]), np.array([[-5.0, 5.0]]), np.array([11.0, 12.0]))
    np.testing.assert_array_equal(found, [[5.0], [np.nan], [-5.0]])
    free = find_bang_efforts(motion([5.0, 2.0, -5.0]), np.array([[-np.inf, 5.0]]), np.array([11.0, 12.0]))
    assert np.isnan(free).all()


@pytest.mark.parametrize(
    ("switches", "kept"),
    [
        ([[10.005]], []),  # within a tenth of half the smallest interval from the beginning
        ([[10.02]], [10.02]),
        ([[10.995]], []),
        ([[10.98]], [10.98]),
        ([[10.3], [10.38]], [10.3]),  # within half the smallest interval of another one
        ([[10.3], [10.45]], [10.3, 10.45]),
        ([[10.45], [10.3]], [10.3, 10.45]),
        ([[10.3, 10.35]], [10.3, 10.35]),  # the two of a pulse
        ([[10.005, 10.3]], []),
    ],
)
def test_switches_next_to_each_other_or_to_a_boundary_are_one(switches, kept):
    breaks, boundaries = np.array([10.0, 10.2, 11.0]), np.array([10.0, 11.0])
    assert _spread(switches, breaks, boundaries, 0.1) == pytest.approx(kept)


@pytest.mark.parametrize(
    ("means", "pulse"),
    [
        ([0.0, 5.0], [0.25, 0.75]),
        ([-5.0, 0.0], [0.0833333333, 1.5833333333]),
        ([-7.0, 5.0], [0.0, 1.2]),
        ([5.0, -7.0], [0.8, 2.0]),
    ],
)
def test_a_pulse_lasts_as_long_as_its_impulse_and_stays_within_its_intervals(means, pulse):
    """From 5 to -5 and back, in two intervals of a second; efforts may be beyond a limit by what the solver leaves."""
    found = _pulse_in(np.arange(3.0), np.array([means]), (5.0, -5.0))
    assert found == pytest.approx(pulse)
