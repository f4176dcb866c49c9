"""The highest frequency at which a reference keeps the limits, in closed form."""

import numpy as np
import pytest

from linkplan.planner.closed_chain.prescribed import highest_rate
from tests.support.bodies import HINGE, HINGE_INERTIA, body_problem

AMPLITUDE, EFFORT = np.radians(20.0), 4.0
OF_EFFORT_HZ = np.sqrt(EFFORT / (HINGE_INERTIA * AMPLITUDE)) / (2 * np.pi)


def highest(*limits: str) -> float | None:
    problem = body_problem(HINGE, 'kind = "track"\n', "reference.amplitude_deg.J=20", "reference.frequency_hz=5", *limits)
    rate = highest_rate(problem, problem.start_pose(), 1e-3, 1.0)
    return rate and 5 * rate


def test_an_inertia_s_highest_frequency_is_that_of_its_effort_limit():
    assert highest() == pytest.approx(OF_EFFORT_HZ, rel=1e-6)


def test_a_speed_limit_allows_a_frequency_in_proportion():
    assert highest("limits.speed_deg_s.J=60") == pytest.approx(60 / 20 / (2 * np.pi), rel=1e-6)


def test_a_limit_on_acceleration_is_one_of_those_that_are_kept():
    asked = highest("limits.acceleration_deg_s2.J=200")
    assert asked == pytest.approx(np.sqrt(200 / 20) / (2 * np.pi), rel=1e-6)


def test_beyond_its_range_no_frequency_helps():
    assert highest("limits.range_deg.J=[-10, 10]") is None
