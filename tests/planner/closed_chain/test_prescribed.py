"""References that are followed exactly: the motion is the sinusoid everywhere, and its largest excess has its instant."""

import numpy as np
import pytest

from linkplan.planner.closed_chain.prescribed import prescribe, reference_demand
from linkplan.planner.problem.problem import Problem
from tests.support.bodies import HINGE, HINGE_INERTIA, body_problem

AMPLITUDE, BIAS, PULSE = np.radians(20.0), np.radians(5.0), 2 * np.pi * 0.5


def followed(*more: str) -> Problem:
    """Return the problem of an inertia that follows a sinusoid of 0.5 Hz."""
    sine = ("reference.amplitude_deg.J=20", "reference.bias_deg.J=5", "reference.frequency_hz=0.5")
    return body_problem(HINGE, 'kind = "track"\n', *sine, *more)


def test_a_reference_is_followed_between_the_breaks_too():
    problem = followed()
    motion = prescribe(problem, problem.start_pose())
    assert motion.periodic
    t = np.linspace(0.0, 1.999, 997)
    swing = AMPLITUDE * np.sin(PULSE * t)
    assert motion.position_at(t)[:, 0] == pytest.approx(BIAS + swing, abs=1e-11)
    assert motion.velocity_at(t)[:, 0] == pytest.approx(AMPLITUDE * PULSE * np.cos(PULSE * t), abs=1e-11)
    assert motion.effort_at(t)[:, 0] == pytest.approx(-HINGE_INERTIA * PULSE**2 * swing, abs=1e-10)


@pytest.mark.parametrize(("duration", "n_intervals"), [(2.0, 12), (3.0, 18), (0.5, 8)])
def test_a_followed_reference_has_the_intervals_asked_for_in_each_period_and_at_least_eight(duration, n_intervals):
    problem = followed("mesh.intervals=12", f"motion.duration_s={duration}")
    motion = prescribe(problem, problem.start_pose())
    np.testing.assert_allclose(motion.breaks_s, np.linspace(0.0, duration, n_intervals + 1), atol=1e-12)
    assert motion.periodic is (duration == 2.0)


@pytest.mark.parametrize(("duration", "instant"), [(2.0, 0.5), (0.4, 0.4)], ids=["within", "at the end"])
def test_the_largest_excess_over_a_range_is_named_with_its_instant(duration, instant):
    problem = followed("limits.range_deg.J=[-90, 10]", f"motion.duration_s={duration}")
    demand = reference_demand(problem, problem.start_pose())
    assert (demand.what, demand.name) == ("range", "J")
    assert demand.limit == pytest.approx(10.0)
    assert demand.needed == pytest.approx(5.0 + 20.0 * np.sin(PULSE * instant), rel=1e-6)
    assert demand.time_s == pytest.approx(instant, abs=1e-4)


def test_the_largest_excess_over_a_speed_at_the_beginning_is_named_with_its_instant():
    problem = followed("limits.speed_deg_s.J=[-90, 30]", "motion.duration_s=0.4")
    demand = reference_demand(problem, problem.start_pose())
    assert (demand.what, demand.unit) == ("speed", "deg/s")
    assert demand.needed == pytest.approx(20.0 * PULSE, rel=1e-6)
    assert demand.time_s == pytest.approx(0.0, abs=1e-4)


def test_a_reference_within_its_limits_needs_nothing():
    problem = followed("limits.range_deg.J=[-90, 26]")
    assert reference_demand(problem, problem.start_pose()) is None
