"""One joint or speed beyond its range is an overrun for refinement, even if all the others keep theirs."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.closed_chain.case import case_of
from tests.support.plans import planned


@pytest.mark.parametrize("name", ["position_margin_rad", "speed_margin_rad_s"])
def test_one_joint_beyond_its_range_is_an_overrun(name):
    plan = planned("knee-reach")
    case = case_of(plan.problem)
    assert not case.error_report(plan.certificate).overruns
    margins = np.array(getattr(plan.certificate, name))
    assert margins.size > 1
    margins[-1] = -0.01
    report = case.error_report(replace(plan.certificate, **{name: margins}))
    assert report.overruns
    assert report.leaves_positions == (name == "position_margin_rad")


def test_the_overrun_of_an_interval_is_the_largest_of_all_joints():
    plan = planned("knee-reach")
    overrun = np.zeros_like(plan.certificate.speed_overrun)
    overrun[0, 1], overrun[-1, 2] = 0.3, 0.2
    report = case_of(plan.problem).error_report(replace(plan.certificate, speed_overrun=overrun))
    assert report.overrun[[1, 2]] == pytest.approx([0.3, 0.2])
