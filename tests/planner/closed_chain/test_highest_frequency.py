"""The highest frequency at which a reference keeps the limits, in closed form."""

import numpy as np
import pytest

from linkplan.planner.closed_chain.prescribed import highest_frequency
from tests.support.bodies import HINGE, HINGE_INERTIA, body_problem

AMPLITUDE, EFFORT = np.radians(20.0), 4.0
OF_EFFORT_HZ = np.sqrt(EFFORT / (HINGE_INERTIA * AMPLITUDE)) / (2 * np.pi)


def highest(*limits: str) -> float | None:
    problem = body_problem(HINGE, 'kind = "track"\n', "reference.amplitude_deg.J=20", "reference.frequency_hz=5", *limits)
    return highest_frequency(problem, problem.start_pose())


def test_an_inertia_s_highest_frequency_is_that_of_its_effort_limit():
    assert highest() == pytest.approx(OF_EFFORT_HZ, rel=2e-5)


def test_a_speed_limit_allows_a_frequency_in_proportion():
    assert highest("limits.speed_deg_s.J=60") == pytest.approx(60 / 20 / (2 * np.pi), rel=2e-5)


def test_beyond_its_range_no_frequency_helps():
    assert highest("limits.range_deg.J=[-10, 10]") is None
