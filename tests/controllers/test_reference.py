"""The sampled motion between, after and beyond its samples."""

import numpy as np
import pytest

from linkplan.controllers.reference import SampledReference, pose_advance, sample, state_at
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.trajectory import Trajectory
from tests.support.bodies import HINGE
from tests.support.motions import motion_along
from tests.support.tolerances_planner import ROUNDING

PERIOD = 0.01


def cubic_samples(n: int = 6) -> tuple[SampledReference, np.polynomial.Polynomial]:
    """Return n samples of a cubic in time, and the cubic."""
    path = np.polynomial.Polynomial([0.3, -2.0, 40.0, 700.0])
    time = PERIOD * np.arange(n)
    reference = SampledReference(
        period_s=PERIOD, time_s=time, pose_rad=path(time)[:, None], position_rad=path(time)[:, None],
        velocity_rad_s=path.deriv()(time)[:, None], effort=np.zeros((n, 1)), cycle=None,
    )  # fmt: skip
    return reference, path


def turning(start: float, periods: float) -> Trajectory:
    """Return a hinge's turn at constant speed from a start [rad], over a number of control periods."""
    return motion_along([0.0, periods * PERIOD], start + np.array([0.0, 2 * np.pi]), periodic=True)


@pytest.mark.parametrize("at", [0.0, 0.4, 1.0, 2.75, 4.0, 4.99])
def test_between_samples_a_cubic_motion_is_itself(at):
    reference, path = cubic_samples()
    position, velocity = state_at(reference, at * PERIOD)
    assert position == pytest.approx([path(at * PERIOD)], abs=ROUNDING)
    assert velocity == pytest.approx([path.deriv()(at * PERIOD)], abs=1e3 * ROUNDING)


@pytest.mark.parametrize("beyond", [0.5, 1.0, 3.25])
def test_after_the_last_sample_the_motion_goes_on_at_its_last_velocity(beyond):
    reference, _ = cubic_samples()
    last, speed = reference.position_rad[-1], reference.velocity_rad_s[-1]
    position, velocity = state_at(reference, reference.time_s[-1] + beyond * PERIOD)
    assert position == pytest.approx(last + beyond * PERIOD * speed, abs=ROUNDING)
    assert velocity == pytest.approx(speed, abs=1e3 * ROUNDING)


def test_a_turn_from_anywhere_advances_by_one_turn():
    mechanism = load_mechanism(HINGE)
    assert pose_advance(mechanism, turning(2.0, 4)) == pytest.approx([2 * np.pi])
    reference = sample(mechanism, turning(2.0, 4), PERIOD, 10 * PERIOD)
    assert reference.pose_rad[:, 0] == pytest.approx(2.0 + 0.5 * np.pi * np.arange(10), abs=1e-12)


def test_later_cycles_repeat_the_first_to_the_last_bit():
    """Trackers take their gains of a cycle once."""
    reference = sample(load_mechanism(HINGE), swinging(7), PERIOD, 30 * PERIOD)
    assert reference.cycle == 7
    for name in ("position_rad", "velocity_rad_s", "effort"):
        values = getattr(reference, name)
        assert np.ptp(values) > 0  # it moves
        assert np.array_equal(values[7:14], values[:7])
        assert np.array_equal(values[21:28], values[:7])


def swinging(periods: int) -> Trajectory:
    """Return a hinge's swing that begins and ends in one place at one speed."""
    duration = periods * PERIOD
    position = np.array([0.0, 0.1, -0.1, 0.0]).reshape(4, 1, 1)
    return motion_along([0.0, duration], position, periodic=True)


@pytest.mark.parametrize(("ratio", "cycle"), [(7.0, 7), (7.0 + 1e-8, 7), (7.0 + 1e-4, None), (7.5, None)])
def test_a_cycle_is_a_whole_number_of_periods_but_for_rounding(ratio, cycle):
    assert sample(load_mechanism(HINGE), turning(0.0, ratio), PERIOD, 20 * PERIOD).cycle == cycle
