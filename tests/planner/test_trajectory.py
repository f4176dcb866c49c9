"""A motion within its ends, beyond them, and over further periods, in closed form."""

import numpy as np
import pytest

from linkplan.planner.trajectory import Trajectory

BREAKS = np.array([1.0, 1.5, 3.0])
TURN = 2 * np.pi


def accelerated() -> Trajectory:
    """Return s = (t - 1) + (t - 1)^2 with v = 1 + 2 (t - 1), and an effort of 3 and then 4."""
    t, h = BREAKS - 1.0, np.diff(BREAKS)
    s, v = t + t**2, 1.0 + 2 * t
    return Trajectory(
        breaks_s=BREAKS,
        position=np.array([s[:-1], s[:-1] + h * v[:-1] / 2, s[1:]])[:, :, None],
        velocity=np.array([v[:-1], v[1:]])[:, :, None],
        effort=np.array([[[3.0], [4.0]]]),
        start_pose=np.zeros(1),
        periodic=False,
    )


def turning() -> Trajectory:
    """Return a turn at a constant speed from 1 s to 3 s, again and again."""
    s = TURN * (BREAKS - 1.0) / 2.0
    return Trajectory(
        breaks_s=BREAKS,
        position=np.array([s[:-1], s[1:]])[:, :, None],
        velocity=np.full((1, 2, 1), TURN / 2.0),
        effort=np.array([[[3.0], [4.0]]]),
        start_pose=np.zeros(1),
        periodic=True,
    )


def test_within_its_ends_a_motion_is_its_polynomials():
    motion, time = accelerated(), np.array([1.0, 1.2, 1.5, 2.9, 3.0])
    t = time - 1.0
    np.testing.assert_allclose(motion.position_at(time)[:, 0], t + t**2)
    np.testing.assert_allclose(motion.velocity_at(time)[:, 0], 1 + 2 * t)
    np.testing.assert_allclose(motion.slope_at(time)[:, 0], 1 + 2 * t)
    np.testing.assert_allclose(motion.acceleration_at(time)[:, 0], 2.0)
    assert motion.effort_at(time)[:, 0].tolist() == [3.0, 3.0, 4.0, 4.0, 4.0]


def test_beyond_its_ends_a_motion_rests_under_the_effort_of_the_nearer_end():
    motion, time = accelerated(), np.array([0.0, 0.99, 3.01, 9.0])
    assert motion.position_at(time)[:, 0].tolist() == [0.0, 0.0, 6.0, 6.0]
    assert not motion.velocity_at(time).any()
    assert not motion.acceleration_at(time).any()
    assert motion.effort_at(time)[:, 0].tolist() == [3.0, 3.0, 4.0, 4.0]


def test_a_periodic_motion_goes_on_with_its_turns_on_both_sides():
    motion, time = turning(), np.array([-3.5, 0.5, 1.0, 2.0, 3.5, 7.25])
    assert motion.advance == pytest.approx(TURN)
    assert motion.periods_at(time).tolist() == [-3, -1, 0, 0, 1, 3]
    np.testing.assert_allclose(motion.position_at(time)[:, 0], TURN * (time - 1.0) / 2.0)
    np.testing.assert_allclose(motion.velocity_at(time)[:, 0], TURN / 2.0)


def test_dense_times_have_both_sides_of_every_break():
    time = accelerated().dense_times(2)
    np.testing.assert_allclose(time, [1.0, 1.25, 1.5, 1.5, 2.25, 3.0])
    assert time[2] < 1.5 <= time[3]
