"""Reach, motor gains, stiffness and margins of geared, screw-driven and scissor linkages, against MuJoCo's rows alone."""

import control
import numpy as np
import pytest
import scipy.linalg

from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.reach import reach
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.feedback.frequency.feedback_loops import operating_point, sampled_law
from linkplan.studies.feedback.tune.requirements import Requirements
from linkplan.studies.feedback.tune.tune import tune
from tests.support.driven_linkages import MODELS, Linkage

PERIOD_S = 1e-3
POSITIONS = {
    "geared crank": [0.3, 1.2, 2.4],
    "scissor lift": [-0.1, 0.1, 0.25],
    "rack and rocker": [-0.1, 0.0, 0.15],
    "four-bar hatch": [0.0, 0.3, 0.6],
}


@pytest.mark.parametrize("name", MODELS)
def test_the_motor_reaches_over_all_that_its_linkage_does(name):
    text, _, ends = MODELS[name]
    can = reach(load_mechanism(text))
    assert [can.lower.position, can.upper.position] == pytest.approx(ends, rel=1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_gains_at_the_motor_stiffness_and_margins_are_those_of_mujocos_rows(name):
    text, joint, _ = MODELS[name]
    mechanism, linkage = load_mechanism(text, independent=[joint]), Linkage(text, joint)
    points = [operating_point(mechanism, np.array([x])) for x in POSITIONS[name]]
    law = sampled_law(mechanism, "pd", Tracking(period_s=PERIOD_S), mechanism.effort_limit)
    found = tune(points, Requirements(bandwidth_hz=8.0, phase_margin_deg=60.0), law)
    assert found.found
    (motor,), settings = found.motors, found.best.law.settings
    for k, position in enumerate(POSITIONS[name]):
        pose = linkage.closed(linkage.pose, position)
        here, passive, margins = linkage.at(pose), linkage.stiffness(pose), found.points[k]
        assert motor.values["kp"][k] == pytest.approx(settings.kp / here.ratio**2, rel=1e-9)
        assert motor.values["kd"][k] == pytest.approx(settings.kd / here.ratio**2, rel=1e-9)
        assert margins.stiffness_at_rest == pytest.approx(settings.kp + passive, rel=1e-5)
        assert margins.response_at_rest == pytest.approx(settings.kp / (settings.kp + passive), rel=1e-5)
        A = np.array([[0.0, 1.0], [-passive / here.inertia, -here.damping / here.inertia]])
        block = np.vstack([np.hstack([A, [[0.0], [1.0 / here.inertia]]]), np.zeros((1, 3))])
        step = scipy.linalg.expm(block * PERIOD_S)
        loop = control.StateSpace(step[:2, :2], step[:2, 2:], [[settings.kp, settings.kd]], 0, PERIOD_S)
        # MuJoCo's own steps differ from an exact hold by some share of a step of delay.
        assert control.stability_margins(loop)[1] == pytest.approx(margins.phase_margin_deg, abs=1.0)
