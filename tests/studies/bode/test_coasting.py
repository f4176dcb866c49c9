"""Feedback loops of a leg on a boom that coasts about its post: responses, margins and LQR leave the boom free."""

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.feedback.bode.bode import bode_study
from linkplan.studies.feedback.bode.bode_report import bode_sections
from linkplan.studies.feedback.frequency.excitation import Setup
from linkplan.studies.feedback.frequency.feedback_loops import operating_point, sampled_law
from tests.support.boom import boom

GAINS = Tracking(kp={"turn": 0.0, "hip": 60.0, "knee": 20.0}, kd={"turn": 0.0, "hip": 2.0, "knee": 0.5}, period_s=1e-3)


@pytest.fixture(scope="module")
def leg():
    return load_mechanism(boom())


def test_responses_of_the_leg_are_measured_as_predicted_while_the_boom_coasts(leg):
    study = bode_study(
        leg,
        np.array([[0.0, 0.3, -0.4]]),
        GAINS,
        leg.effort_limit,
        setup=Setup(),
        frequency_hz=np.array([3.0, 20.0]),
        scanned=0,
    )
    assert [entry.channel for entry in study.points] == [1, 2]
    for entry in study.points:
        assert entry.settles_in_mujoco
        for quantity, response in entry.responses.items():
            assert response.gain == pytest.approx(entry.predicted[quantity].gain, rel=1e-5)
    assert study.softness is None
    titles = [section.title for section in bode_sections(study, "the leg")]
    assert titles == ["Feedback loop: the leg", "Frequency response of hip", "Frequency response of knee"]


def test_lqr_regulates_the_leg_and_leaves_the_boom_alone(leg):
    law = sampled_law(leg, "lqr", GAINS, leg.effort_limit)
    loop = law.loop(operating_point(leg, np.array([0.0, 0.3, -0.4])))
    assert loop.stable
    assert np.all(loop.gain[:, [0, 3]] == 0)
    assert np.all(np.diag(loop.gain[:, 1:3]) > 0)
