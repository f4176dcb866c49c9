"""Margins of given responses, where they follow from the response in closed form."""

from collections.abc import Callable

import numpy as np
import pytest

from linkplan.controllers.sampling import Sampling
from linkplan.models.mechanism import load_mechanism
from linkplan.studies.feedback.frequency.feedback_loops import CONTINUOUS, FeedbackLoop, feedback_loop, operating_point
from linkplan.studies.feedback.frequency.margins import Margins, margins
from tests.support.oscillators import inertia_alone

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
