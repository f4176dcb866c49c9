"""Ranges of a servo's ctrl that the program does not impose: the certificate checks them."""

import numpy as np
import pytest

from linkplan.planner.certificate.certificate import certify
from tests.support.bodies import body_problem
from tests.support.motions import motion_along

# A flywheel of 1 kg m2; its actuator gives (1 + q) N.m per unit of ctrl at the angle q, more and more on the way.
FLYWHEEL = """<mujoco><compiler angle="radian"/><option gravity="0 0 0"/><worldbody><body><joint name="J" axis="0 1 0"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody>
<actuator><general name="m" joint="J" gaintype="affine" gainprm="1 1 0" ctrlrange="-3 {most}"/></actuator></mujoco>"""
TORQUE = 2.0


def failures(most: float, model: str = FLYWHEEL, efforts: tuple[float, ...] = (TORQUE,), limits: str = "") -> list[str]:
    """Return what the certificate says of ctrl along q = t^2, for which the ctrl 2 / (1 + q) is needed."""
    motion = 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 57.29577951308232 }\nduration_s = 1.0\n'
    problem = body_problem(model.format(most=most), motion + limits)
    trajectory = motion_along([0.0, 1.0], [0.0, 0.0, 1.0], effort=np.reshape(efforts, (1, 1, -1)))
    return [said for said in certify(problem, trajectory).failures if "ctrl" in said]


def test_a_ctrl_beyond_its_range_at_the_start_alone_is_said_with_its_excess():
    (said,) = failures(1.5)
    assert said.startswith("m would need a ctrl 0.5 beyond its range at t = 0 s")


@pytest.mark.parametrize("most", [2.0, 2.5])
def test_a_ctrl_within_its_range_is_not_named(most):
    assert failures(most) == []


def test_a_motor_beside_a_servo_gives_what_limits_effort_allows():
    beside = FLYWHEEL.replace("</actuator>", '<motor name="p" joint="J" ctrlrange="-1 1"/></actuator>')
    assert failures(2.5, beside, (0.0, TORQUE), "[limits]\neffort = { p = [-3.0, 3.0] }\n") == []
