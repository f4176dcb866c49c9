"""Arguments of public functions that are of another type than theirs."""

import numpy as np
import pytest

import linkplan
from tests.support.refusals import assert_refused

PENDULUM = """<mujoco model="pendulum"><worldbody><body><joint name="J" axis="0 1 0" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0 0 -.5" size=".02"/></body></worldbody>
<actuator><motor name="m" joint="J" ctrlrange="-20 20"/></actuator></mujoco>"""
ARRAY = np.array([True, False])


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: linkplan.plan("knee-reach", prove=ARRAY), "prove must be True or False, got array([ True, False])"),
        (lambda: linkplan.prove("knee-reach", existence=2), "existence must be True or False, got 2"),
        (lambda: linkplan.bode("optimus-knee", large=ARRAY), "large must be True or False"),
        (lambda: linkplan.load_mechanism("optimus-knee", fix_base=ARRAY), "mechanism.fix_base must be true or false"),
        (
            lambda: linkplan.transfer("optimus-knee", ["C"], range_deg=-1),
            "range_deg must be a table of joint = [low, high], got -1",
        ),
        (lambda: linkplan.report("knee-reach", "reach.pdf"), "'reach.pdf' must end in .html or .htm, got '.pdf'"),
    ],
)
def test_an_argument_of_another_type_is_refused_by_name(call, said):
    assert_refused(call, said)


def test_a_test_signal_of_more_than_half_a_turn_is_refused():
    mechanism = linkplan.load_mechanism(PENDULUM)
    asked = {"tracking": {"kp": 50.0, "kd": 2.0}, "frequency_hz": [5.0], "at_deg": [0.0]}
    assert_refused(
        lambda: linkplan.bode(mechanism, **asked, amplitude_deg=1e9), "amplitude_deg must be at most 180 deg, got 1e+09"
    )
