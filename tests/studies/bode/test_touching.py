"""Feedback loops of mechanisms whose links push each other: said, and not measured as if it were the loop."""

import re
from functools import cache

import numpy as np

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.feedback.bode.bode import BodeStudy, bode_study
from linkplan.studies.feedback.bode.bode_blocks import summary
from linkplan.studies.feedback.frequency.excitation import Setup
from linkplan.studies.output.text import text_of
from tests.support.drawn_by_others import HOEKEN, MOTOR

# Hoeken's linkage as somebody writes it, its coupler and rocker drawn through each other.
THROUGH = re.sub(r"<contact>.*?</contact>", "", HOEKEN.format(actuator=MOTOR), flags=re.S)
GAINS = Tracking(kp=2.0, kd=0.02, period_s=2e-3)


@cache
def study() -> BodeStudy:
    mechanism = load_mechanism(THROUGH, solref="stiff")
    positions, limit = np.radians([[10.0], [25.0]]), mechanism.effort_limit
    return bode_study(mechanism, positions, GAINS, limit, setup=Setup(), frequency_hz=np.array([1.0, 5.0]), scanned=0)


def test_contacts_at_a_pose_are_named_with_the_line_that_lets_links_pass():
    text = text_of(summary(study()))
    assert "contacts of geom 1 of coupler and geom 2 of rocker push in MuJoCo at 2 of 2 poses" in text
    assert '<exclude body1="coupler" body2="rocker"/>' in text
    assert "contacts of" in study().contacts


def test_no_response_is_measured_where_contacts_push():
    assert all(point.stable for point in study().points)  # or nothing would be measured anyway
    assert study().measurement is None
    assert not any(point.responses for point in study().points)
    assert "not measured: contacts push" in text_of(summary(study()))


def test_without_contacts_nothing_is_said_of_them():
    mechanism = load_mechanism(HOEKEN.format(actuator=MOTOR), solref="stiff")
    found = bode_study(mechanism, np.radians([[10.0]]), GAINS, mechanism.effort_limit, scanned=0)
    assert found.contacts is None
    assert "contacts" not in text_of(summary(found))
