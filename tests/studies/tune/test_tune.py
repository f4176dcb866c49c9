"""Gains from requirements: what is asked for is met at every angle, or a sentence says why not."""

import numpy as np
import pytest

from linkplan.controllers.sampling import sampling
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.frequency.feedback_loops import feedback_loop, law_gain, operating_point
from linkplan.studies.frequency.margins import margins
from linkplan.studies.tune.tune import Wanted, tune
from linkplan.studies.tune.tune_report import motor_gains, tune_record, tune_text
from tests.support.oscillators import inertia_alone, mass_on_a_spring
from tests.support.tolerances_loops import GAINS_SCALED

ANGLES_DEG = (-49.0, 3.6, 56.0)


def tuned(payload, law, bandwidth_hz, phase_margin_deg, period_s, delay=0.0, peak=np.inf):
    """Return the tuning of the knee."""
    mechanism = load_mechanism("optimus-knee", payload=payload)
    points = [operating_point(mechanism, np.radians([angle])) for angle in ANGLES_DEG]
    wanted = Wanted(bandwidth_hz=bandwidth_hz, phase_margin_deg=phase_margin_deg, sensitivity_peak=peak)
    timing = sampling(mechanism, period_s, delay)
    return tune(points, wanted, Tracking(period_s=period_s), timing, mechanism.effort_limit, law=law)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("payload", "law", "bandwidth", "phase", "period", "delay"),
    [(None, "pd", 100.0, 60.0, 1e-3, 0), ("shank", "pd", 30.0, 60.0, 1e-3, 1), ("shank", "lqr", 30.0, 50.0, 1e-3, 1)],
)
def test_gains_found_do_what_is_wanted_at_every_angle(payload, law, bandwidth, phase, period, delay):
    found = tuned(payload, law, bandwidth, phase, period, delay)
    assert found.found
    # A second look, from the gains alone.
    mechanism, settings = found.mechanism, found.best.settings
    for point in found.points:
        gain = law_gain(point, law, settings, mechanism.effort_limit)
        bounds = margins(feedback_loop(point, gain, found.timing))
        assert bounds.stable
        assert (bounds.bandwidth_hz or np.inf) >= bandwidth  # none: it reaches the Nyquist frequency
        assert bounds.phase_margin_deg >= phase


@pytest.mark.slow
def test_a_sensitivity_peak_is_kept():
    loose, tight = tuned(None, "pd", 60.0, 30.0, 1e-3), tuned(None, "pd", 60.0, 30.0, 1e-3, peak=1.5)
    assert tight.found
    assert tight.best.worst("sensitivity_peak", largest=True)[0] <= 1.5
    assert loose.best.worst("sensitivity_peak", largest=True)[0] > 1.5


@pytest.mark.slow
def test_what_cannot_be_is_refused_in_a_sentence_with_its_reason():
    found = tuned(None, "pd", 300.0, 60.0, 1e-3, 2)
    assert not found.found
    assert "cannot give 300 Hz and 60 deg" in found.message
    # A hold of 1 ms and a delay of 2 ms: 2.5 ms at 300 Hz.
    assert f"{360 * 300 * 2.5e-3:.3g} deg" in found.message
    assert any(f"O = {angle:.4g} deg" in found.message for angle in ANGLES_DEG)


def test_gains_of_an_inertia_grow_with_the_square_and_the_first_power_of_the_bandwidth():
    mechanism = load_mechanism(inertia_alone(0.05, 3.0))
    point = operating_point(mechanism, np.zeros(1))
    timing = sampling(mechanism, 1e-4)
    kp, kd = [], []
    for bandwidth in (5.0, 10.0):
        wanted = Wanted(bandwidth_hz=bandwidth, phase_margin_deg=60.0)
        found = tune([point], wanted, Tracking(period_s=1e-4), timing, mechanism.effort_limit)
        assert found.found
        kp.append(found.best.settings.kp)
        kd.append(found.best.settings.kd)
    assert kp[1] / kp[0] == pytest.approx(4.0, rel=GAINS_SCALED)
    assert kd[1] / kd[0] == pytest.approx(2.0, rel=GAINS_SCALED)


def test_the_motors_side_sees_gains_through_the_square_of_its_gear():
    oscillator = mass_on_a_spring(gear=5.0)
    mechanism = load_mechanism(oscillator.mjcf)
    point = operating_point(mechanism, np.array([oscillator.position]))
    wanted = Wanted(bandwidth_hz=10.0, phase_margin_deg=40.0)
    found = tune([point], wanted, Tracking(period_s=1e-3), sampling(mechanism, 1e-3), mechanism.effort_limit)
    motor = motor_gains(found)
    assert motor["kp"] == pytest.approx(found.best.settings.kp / 25)
    # The effort of the actuator at a joint's error e is kp e / gear, at the motor's own motion gear e: kp / gear^2.
    gain = law_gain(point, "pd", found.best.settings, mechanism.effort_limit)
    assert gain[0, 0] / 5.0 == pytest.approx(motor["kp"])
    assert "N/m" in tune_text(found)
    assert tune_record(found)["gains"]["motor_side"]["gear"] == 5.0


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"bandwidth_hz": -1.0, "phase_margin_deg": 60.0}, "positive number of hertz"),
        ({"bandwidth_hz": 10.0, "phase_margin_deg": 190.0}, "0 to 180"),
        ({"bandwidth_hz": 10.0, "phase_margin_deg": 60.0, "sensitivity_peak": 0.9}, "above 1"),
    ],
)
def test_wanted_nonsense_is_refused(values, words):
    with pytest.raises(LinkplanError, match=words):
        Wanted(**values)


def test_a_bandwidth_beyond_nyquist_is_refused():
    with pytest.raises(LinkplanError, match="Nyquist"):
        tuned(None, "pd", 600.0, 60.0, 1e-3)
