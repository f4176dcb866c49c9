"""The rates of efforts, against those of polynomials that jump from one interval to the next."""

import numpy as np
import pytest

from linkplan.planner.limits.actuators import effort_rates
from linkplan.planner.trajectory import Trajectory

BREAKS_S = np.array([0.0, 1.0, 3.0, 3.5])
JUMP = -20.0


def parabola_with_a_jump() -> Trajectory:
    """Return a motion with the effort t^2, and t^2 + JUMP after the second break."""
    begin, end = BREAKS_S[:-1], BREAKS_S[1:]
    effort = np.array([begin**2, begin * end, end**2])
    effort[:, 2] += JUMP
    still = np.zeros((3, 3, 1))
    return Trajectory(
        breaks_s=BREAKS_S,
        position=still,
        velocity=still[:2],
        effort=effort[:, :, None],
        start_pose=np.zeros(1),
        periodic=False,
    )


def test_the_rate_of_an_effort_is_its_derivative_in_every_interval_up_to_both_ends():
    time = np.array([0.0, 0.25, 0.9, 1.0, 2.0, 2.9, 3.1, 3.4, 3.5])
    rate, _ = effort_rates(parabola_with_a_jump(), time)
    assert rate[:, 0] == pytest.approx(2 * time, rel=1e-12, abs=1e-12)


def test_a_jump_is_an_infinite_rate_at_the_first_instant_after_it_alone():
    _, jumps = effort_rates(parabola_with_a_jump(), np.array([0.5, 1.0, 2.9, 3.1, 3.4]))
    np.testing.assert_array_equal(jumps[:, 0], [np.nan, np.nan, np.nan, -np.inf, np.nan])


def test_a_constant_effort_has_no_rate():
    still = np.zeros((3, 3, 1))
    trajectory = Trajectory(
        breaks_s=BREAKS_S,
        position=still,
        velocity=still[:2],
        effort=np.full((1, 3, 1), 7.0),
        start_pose=np.zeros(1),
        periodic=False,
    )
    rate, jumps = effort_rates(trajectory, np.array([0.0, 1.0, 3.5]))
    assert not rate.any()
    assert np.isnan(jumps).all()
