"""Gains hold a joint near its reference at rest, although weight and springs pull it away."""

import mujoco
import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.feedback.bode.bode import bode_study
from linkplan.studies.feedback.bode.bode_blocks import summary
from linkplan.studies.feedback.frequency.feedback_loops import feedback_loop, law_gain, operating_point, sampled_law
from linkplan.studies.feedback.frequency.margins import margins
from linkplan.studies.feedback.tune.requirements import Requirements
from linkplan.studies.feedback.tune.tune import Tuning, tune
from linkplan.studies.feedback.tune.tune_report import tune_blocks
from linkplan.studies.output.text import text_of

MASS_KG, LENGTH_M, ANGLE = 2.0, 0.5, np.radians(20.0)
# A mass on a light rod that hangs: its weight gives the hinge a stiffness of m g l cos(angle).
HANGING = f"""<mujoco><option timestep="5e-4" integrator="implicitfast"/><worldbody>
  <body><joint name="arm" axis="0 1 0" damping="0.1"/>
    <inertial mass="{MASS_KG}" pos="0 0 {-LENGTH_M}" diaginertia="1e-3 1e-3 1e-3"/>
  </body></worldbody><actuator><motor name="m" joint="arm" ctrlrange="-50 50"/></actuator></mujoco>"""
WEIGHT_STIFFNESS = MASS_KG * 9.81 * LENGTH_M * np.cos(ANGLE)
PERIOD_S = 1e-3


def point_and_law():
    mechanism = load_mechanism(HANGING)
    law = sampled_law(mechanism, "pd", Tracking(period_s=PERIOD_S), mechanism.effort_limit)
    return operating_point(mechanism, np.array([ANGLE])), law


def tuned(bandwidth_hz: float, **wanted) -> Tuning:
    point, law = point_and_law()
    return tune([point], Requirements(bandwidth_hz=bandwidth_hz, phase_margin_deg=60.0, **wanted), law)


def test_a_weak_loop_has_the_response_at_rest_of_weight_and_gain_and_no_bandwidth():
    point, law = point_and_law()
    for kp in (3.0, 30.0):
        settings = Tracking(kp=kp, kd=2.0, period_s=PERIOD_S)
        found = margins(feedback_loop(point, law_gain(point, "pd", settings, law.effort_limit), law.timing))
        assert found.response_at_rest == pytest.approx(kp / (kp + WEIGHT_STIFFNESS), rel=1e-9)
        assert found.stiffness_at_rest == pytest.approx(kp + WEIGHT_STIFFNESS, rel=1e-9)
        assert (found.bandwidth_hz == 0.0) == (kp < WEIGHT_STIFFNESS)  # below -3 dB from the start


@pytest.mark.parametrize("bandwidth_hz", [0.3, 1.0, 4.0])
def test_gains_settle_within_five_percent_of_a_small_step_in_mujoco(bandwidth_hz):
    found = tuned(bandwidth_hz)
    assert found.found
    (loop,) = found.best.loops
    settings, step = found.best.law.settings, np.radians(0.5)
    model = mujoco.MjModel.from_xml_string(HANGING)
    data = mujoco.MjData(model)
    data.qpos[0] = ANGLE
    hold = MASS_KG * 9.81 * LENGTH_M * np.sin(ANGLE)
    for _ in range(int(20 / PERIOD_S)):
        data.ctrl[0] = hold + settings.kp * (ANGLE + step - data.qpos[0]) - settings.kd * data.qvel[0]
        mujoco.mj_step(model, data, int(PERIOD_S / model.opt.timestep))
    reached = (data.qpos[0] - ANGLE) / step
    assert reached >= 0.949
    assert reached == pytest.approx(loop.response_at_rest, abs=2e-3)  # the weight's stiffness changes over the step


def test_a_named_stiffness_replaces_the_response_at_rest():
    found = tuned(1.0, stiffness=20.0)
    assert found.found
    (loop,) = found.best.loops
    assert loop.stiffness_at_rest >= 20.0
    assert loop.response_at_rest < 0.95
    assert "stiffness at rest" in text_of(tune_blocks(found))


def test_a_stiffness_that_no_gain_gives_is_named():
    found = tuned(1.0, stiffness=1e7)
    assert not found.found
    assert "stiffness at rest" in found.message or "stable" in found.message


def test_bode_states_the_response_at_rest_of_a_joint_that_sags():
    mechanism = load_mechanism(HANGING)
    weak, strong = (
        text_of(
            summary(bode_study(mechanism, np.array([[ANGLE]]), Tracking(kp=kp, kd=2.0), mechanism.effort_limit, scanned=0))
        )
        for kp in (3.0, 300.0)
    )
    assert "response at rest" in weak
    assert "response at rest" not in strong
