"""Phases over frequency: full turns between nearly equal responses are taken out where they are."""

import numpy as np

from linkplan.studies.feedback.bode.curves import phase_along


def test_a_phase_that_passes_a_resonance_the_other_way_round_stays_beside_the_first():
    frequency = np.array([0.1, 0.5, 0.9, 1.1, 2.0, 10.0])
    predicted = np.array([-180.0, -180.0, 0.0, -180.0, -180.0, -180.0])
    delay = np.array([-0.1, -0.5, -0.9, -100.0, -170.0, -300.0])
    passed = predicted + delay + np.array([360.0, 360.0, 360.0, 720.0, 720.0, 720.0])
    np.testing.assert_allclose(phase_along(frequency, passed, frequency, predicted), predicted + delay)
