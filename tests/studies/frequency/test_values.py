"""A response as a value, frequencies of whole samples, several freedoms, and what is refused."""

import numpy as np
import pytest

from linkplan.controllers.sampling import sampling
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.feedback.bode.bode import bode_study
from linkplan.studies.feedback.frequency.excitation import whole_samples
from linkplan.studies.feedback.frequency.feedback_loops import feedback_loop, law_gain, operating_point
from linkplan.studies.feedback.frequency.sinestream import measure
from tests.support.mechanisms import FIVE_BAR
from tests.support.tolerances_loops import COUPLED_DB, COUPLED_DEG, NEAREST_WHOLE


def test_measured_frequencies_repeat_after_whole_samples_next_to_those_asked_for():
    asked = np.geomspace(0.7, 499.0, 60)
    p, N = whole_samples(asked, 1e-3)
    assert np.all(np.gcd(p, N) == 1)
    assert np.all(2 * p < N)
    found = p / (N * 1e-3)
    assert np.all(np.diff(found) > 0)
    low = asked < 450
    nearest = np.abs(found[:, None] / asked[None, low] - 1).min(axis=0)
    assert nearest.max() < NEAREST_WHOLE


def five_bar_loops():
    mechanism = load_mechanism(FIVE_BAR)
    assert mechanism.dof == mechanism.n_u == 2
    settings = Tracking(kp=20.0, kd=1.0, period_s=1e-3)
    point = operating_point(mechanism, mechanism.home[mechanism.independent])
    gain = law_gain(point, "pd", settings, mechanism.effort_limit)
    return mechanism, feedback_loop(point, gain, sampling(mechanism, 1e-3)), settings


@pytest.mark.slow
def test_each_joints_loop_is_predicted_and_measured_with_the_others_closed():
    mechanism, loop, _ = five_bar_loops()
    for channel in range(2):
        taken = measure([loop], np.array([2.0, 8.0, 30.0]), mechanism.effort_limit, channel=channel)
        for name, response in taken.responses[0].items():
            db, deg = response.against(loop.response(name, response.frequency_hz, channel))
            assert np.abs(db).max() < COUPLED_DB, name
            assert np.abs(deg).max() < COUPLED_DEG, name
    # The other loop matters: without it the first one's plant is another.
    alone = loop.plant(np.array([2.0]))[0, 0, 0]
    assert abs(loop.gains("plant", np.array([2.0]), 0)[0] / alone - 1) > 0.01


def test_the_study_has_a_loop_for_every_joint():
    from linkplan.studies.feedback.bode.bode_blocks import summary
    from linkplan.studies.output.text import text_of

    mechanism, _, settings = five_bar_loops()
    home = mechanism.home[mechanism.independent][None]
    study = bode_study(mechanism, home, settings, mechanism.effort_limit, scanned=0)
    loops = study.poses[0].loops
    assert list(loops) == [f"pd {joint.name}" for joint in mechanism.independent_joints]
    text = text_of(summary(study))
    assert "stable" in text
    for joint in mechanism.independent_joints:
        assert f"{joint.name} at " in text


@pytest.fixture(scope="module")
def knee():
    return load_mechanism("optimus-knee")


def test_a_pose_that_the_limits_cannot_hold_is_refused():
    heavy = load_mechanism("optimus-knee", payload="shank")
    with pytest.raises(LinkplanError, match=r"cannot be held at O = 56 deg: act_O would need 7\.8\d* N\.m"):
        operating_point(heavy, np.radians([56.0]), np.array([[-2.0, 2.0]]))


def test_a_delay_between_simulator_steps_takes_finer_steps_or_is_refused(knee):
    assert sampling(knee, 1e-4, 0.25).substeps == 4
    with pytest.raises(LinkplanError, match="is not a whole number of simulator steps"):
        sampling(knee, 1e-4, 0.2512)
