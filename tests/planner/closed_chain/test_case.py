"""One joint or speed beyond its range is an overrun for refinement, even if all the others keep theirs."""

import numpy as np
import pytest

from linkplan.planner.closed_chain.case import case_of
from tests.support.margins import with_margin
from tests.support.plans import planned


@pytest.mark.parametrize("what", ["position", "speed"])
def test_one_joint_beyond_its_range_is_an_overrun(what):
    plan = planned("knee-reach", "limits.speed_deg_s.C=1e4")
    case = case_of(plan.problem)
    assert not case.error_report(plan.certificate).overruns
    assert len(plan.certificate.margins) > 1
    report = case.error_report(with_margin(plan.certificate, what, 2, left=-0.01))
    assert report.overruns
    assert report.leaves_positions == (what == "position")


def test_the_overrun_of_an_interval_is_the_largest_of_all_joints():
    plan = planned("knee-reach")
    first, last = np.zeros((2, len(plan.certificate.growth)))
    first[1], last[2] = 0.3, 0.2
    over = with_margin(plan.certificate, "position", 0, overrun=first)
    report = case_of(plan.problem).error_report(with_margin(over, "position", 2, overrun=last))
    assert report.overrun[[1, 2]] == pytest.approx([0.3, 0.2])
