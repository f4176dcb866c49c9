"""Feedback loops of mechanisms whose links push each other: said, and not measured as if it were the loop."""

import re
from functools import cache

import numpy as np

import linkplan
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


def test_no_plant_is_measured_where_contacts_push_and_all_of_it_is_predicted():
    ports = {"from_effort": [study().mechanism.actuators[0].name], "to_position": [study().mechanism.joints[-1].name]}
    found = linkplan.bode(study().mechanism, at_deg=[10.0, 25.0], kp=2.0, kd=0.02, period_s=2e-3, **ports).study
    assert found.measurement is None
    assert len(found.caveats) == 2
    assert all(caveat.endswith("contacts push there") for caveat in found.caveats)
    assert "contacts of" in found.contacts
    assert all(one.moves and not one.measured for point in found.points for one in point.responses.values())


def test_without_contacts_nothing_is_said_of_them():
    mechanism = load_mechanism(HOEKEN.format(actuator=MOTOR), solref="stiff")
    found = bode_study(mechanism, np.radians([[10.0]]), GAINS, mechanism.effort_limit, scanned=0)
    assert found.contacts is None
    assert "contacts" not in text_of(summary(found))
