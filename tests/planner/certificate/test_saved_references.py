"""A saved motion that should follow a reference is compared with it all along."""

from dataclasses import replace

import numpy as np

from linkplan.planner.certificate.further_checks import disagreements
from tests.support.bodies import HINGE, body_plan

SINE = ("reference.amplitude_deg.J=10", "reference.frequency_hz=1")


def test_a_reference_that_is_missed_in_one_interval_is_named():
    plan = body_plan(HINGE, 'kind = "track"\n', *SINE)
    assert plan.passed, plan.message
    assert disagreements(plan.problem, plan.trajectory, plan.objective) == ()
    position = np.array(plan.trajectory.position)
    position[:, 5] += 1e-3
    off = replace(plan.trajectory, position=position)
    assert any("reference is missed" in words for words in disagreements(plan.problem, off, plan.objective))


def test_a_motion_whose_clock_begins_later_follows_its_reference_as_well():
    plan = body_plan(HINGE, 'kind = "track"\n', *SINE)
    later = replace(plan.trajectory, breaks_s=plan.trajectory.breaks_s + 0.3)
    assert disagreements(plan.problem, later, plan.objective) == ()
