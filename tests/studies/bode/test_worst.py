"""The worst pose of a loop over a continuous coordinate, and the peaks of its sensitivity between grid points."""

import numpy as np
import pytest
from scipy.optimize import brentq

from linkplan.controllers.sampling import sampling
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.feedback.bode.bode import bode_study
from linkplan.studies.feedback.bode.bode_report import _less_gain_is_nearer
from linkplan.studies.feedback.bode.poses import loop_poses
from linkplan.studies.feedback.frequency.feedback_loops import feedback_loop, law_gain, operating_point, sampled_law
from linkplan.studies.feedback.frequency.margins import Margins, margins
from linkplan.studies.feedback.frequency.margins import _roots as crossings
from linkplan.studies.feedback.frequency.stability_map import critical_kd
from linkplan.studies.feedback.frequency.worst import refined_minima
from linkplan.studies.feedback.tune.tune import Requirements, tune
from linkplan.studies.output.text import text_of
from tests.support.tolerances_loops import ON_A_GRID

# The largest kd that is stable at kp = 200 and 0.1 ms at every angle of the knee, where MuJoCo settles below and not above.
LARGEST_SAFE_KD, WORST_DEG = 1.834, 62.45


def study_of(kd: float, scanned: int = 41):
    """Return the knee's study over its whole reach, nothing measured."""
    mechanism = load_mechanism("optimus-knee")
    looked = loop_poses(mechanism, None, mechanism.effort_limit)
    settings = Tracking(kp=200.0, kd=kd)
    return bode_study(mechanism, looked.positions, settings, mechanism.effort_limit, scanned=scanned, line=looked.line)


def test_a_gain_that_is_unstable_between_the_angles_of_a_grid_is_called_unstable():
    study = study_of(1.845)
    assert not study.stable
    assert study.message.startswith("unstable at O = 62.4")
    bad = [point for point in study.points if not point.stable]
    assert [np.degrees(point.point.state[0]) for point in bad] == pytest.approx([WORST_DEG], abs=0.1)
    assert not bad[0].settles_in_mujoco


def test_the_least_gain_margin_over_the_reach_is_the_largest_stable_damping_gain():
    study = study_of(1.0)
    least, k = study.scans[0].least("gain_margin_db")
    assert np.degrees(study.scans[0].positions[k]) == pytest.approx(WORST_DEG, abs=0.1)
    assert least == pytest.approx(5.23, abs=0.01)
    assert min(point.gain_margin_db for point in study.points) == pytest.approx(least, abs=1e-3)
    assert "least gain margin 5.23 dB at O = 62.4" in text_of(study.summary())
    worst = operating_point(study.mechanism, study.scans[0].line.at(study.scans[0].positions[k]))
    assert critical_kd(worst, 200.0, study.law.timing)[1] == pytest.approx(LARGEST_SAFE_KD, abs=1e-3)


def test_local_minima_are_found_between_the_places_of_a_scan():
    at = np.linspace(0.0, 10.0, 12)
    found = refined_minima(lambda x: float(np.cos(2.0 * x) + 0.01 * x), at)
    exact = [brentq(lambda x: -2 * np.sin(2 * x) + 0.01, a, a + 1.0) for a in (1.1, 4.2, 7.3)]
    assert sorted(found)[:3] == pytest.approx(exact, abs=1e-3)


@pytest.mark.filterwarnings("error")
def test_a_minimum_next_to_infinite_values_is_found_without_a_warning():
    """Margins are infinite next to poses without a crossing."""

    def margin(x: float) -> np.float64:
        return np.float64((x - 0.53) ** 2 if abs(x - 0.53) < 0.031 else np.inf)

    at = np.linspace(0.0, 1.0, 11)
    assert refined_minima(margin, at) == pytest.approx([0.53], abs=1e-4)


def test_dips_that_are_rounding_are_no_minima():
    at, rounding = np.linspace(0.0, 1.0, 101), 1e-13 * np.cos(np.arange(101) * np.pi)

    def looked_at(x: float) -> float:
        raise AssertionError(x)

    assert refined_minima(looked_at, at, rounding) == []


def test_a_gain_that_is_real_but_for_rounding_turns_nowhere():
    frequency = np.linspace(1.0, 2.0, 50)
    noise = 1e-15 * np.cos(np.arange(50) * np.pi)
    assert len(crossings(noise, frequency, lambda _: 0.0, 1e-10 * np.ones(50))) == 0
    np.testing.assert_allclose(crossings(frequency - 1.5, frequency, lambda f: f - 1.5, 1e-10 * np.ones(50)), [1.5])


def test_a_narrow_peak_of_sensitivity_is_met_between_frequencies():
    mechanism = load_mechanism("optimus-knee")
    point = operating_point(mechanism, np.radians([60.32]))
    gain = law_gain(point, "pd", Tracking(kp=200.0, kd=1.87), mechanism.effort_limit)
    loop = feedback_loop(point, gain, sampling(mechanism, 1e-4))
    found = margins(loop, refine=False)
    dense = np.abs(loop.gains("sensitivity", np.geomspace(1000.0, 5000.0, 200_001))).max()
    assert found.sensitivity_peak == pytest.approx(dense, rel=1e-6)
    coarse = np.abs(loop.gains("sensitivity", np.geomspace(1000.0, 4990.0, 140))).max()
    assert coarse < (1 - ON_A_GRID) * dense  # a grid of the margins' own density misses it


def test_a_crank_that_nothing_stops_is_looked_at_over_its_whole_turn():
    mechanism = load_mechanism("slider-crank")
    looked = loop_poses(mechanism, None, mechanism.effort_limit)
    assert np.degrees([looked.line.low, looked.line.high]) == pytest.approx([-180.0, 180.0])
    assert np.diff(np.degrees(looked.positions[:, 0])) == pytest.approx(np.full(6, 360 / 7))


@pytest.mark.slow
def test_gains_found_keep_what_is_wanted_over_a_whole_turn_of_a_crank():
    mechanism = load_mechanism("slider-crank")
    looked = loop_poses(mechanism, None, mechanism.effort_limit)
    assert np.ptp(looked.line.states) == pytest.approx(2 * np.pi)
    points = [operating_point(mechanism, np.array([s])) for s in (-np.pi, 0.0)]
    law = sampled_law(mechanism, "pd", Tracking(period_s=1e-3), mechanism.effort_limit)
    wanted = Requirements(bandwidth_hz=30.0, phase_margin_deg=60.0)

    def least(found) -> float:
        bands = []
        for x in np.linspace(looked.line.low, looked.line.high, 61):
            loop = found.best.law.loop(operating_point(mechanism, np.array([x])))
            bands.append(margins(loop, refine=False).bandwidth_hz or np.inf)
        return min(bands)

    poses_alone = tune(points, wanted, law)
    assert poses_alone.found
    assert least(poses_alone) < 29.0  # at its poses 30 Hz, between them not
    everywhere = tune(points, wanted, law, line=looked.line)
    assert everywhere.found
    assert least(everywhere) >= 30.0
    assert "every angle from -180 to 180 deg" in everywhere.message


@pytest.mark.parametrize(
    ("less", "more", "told"), [(None, 12.3, False), (74.9, 12.3, False), (5.4, 37.8, True), (5.4, None, True)]
)
def test_the_gain_reduction_margin_is_told_where_less_gain_is_the_nearer_danger(less, more, told):
    assert _less_gain_is_nearer(Margins(stable=True, gain_reduction_margin_db=less, gain_margin_db=more)) is told
