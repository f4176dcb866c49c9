"""The power that an actuator gives and the power that it takes stand apart, in text, JSON and Python alike."""

import numpy as np
import pytest

import linkplan
from linkplan.planner.plan.folder import record_of
from linkplan.studies.output.document import Table
from linkplan.studies.output.plan_blocks import plan_blocks

# A wheel that is started quickly and stopped slowly: it takes more power to start it.
WHEEL = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="J" axis="0 0 1"/>
<geom type="cylinder" size=".1 .01" mass="2"/></body></worldbody>
<actuator><motor name="M" joint="J" ctrlrange="-0.1 0.4"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def plan():
    wheel = linkplan.load_mechanism(WHEEL)
    return linkplan.plan(
        linkplan.Problem.reach(wheel, start_deg={"J": 0.0}, goal_deg={"J": 90.0}, minimize="time")
    ).require()


def test_the_powers_are_those_of_bang_bang_motion(plan):
    """Torque 4 T and then -T of inertia I: the largest speed w of angle A has w^2 (1 / 8 + 1 / 2) I / T = A."""
    inertia, torque = 0.5 * 2 * 0.1**2, 0.1
    speed = np.sqrt(np.pi / 2 * torque / inertia / (1 / 8 + 1 / 2))
    assert plan.certificate.peak_motor_power == pytest.approx([4 * torque * speed], rel=1e-3)
    assert plan.certificate.peak_brake_power == pytest.approx([torque * speed], rel=1e-3)
    assert plan.certificate.peak_power == pytest.approx(plan.certificate.peak_motor_power)


def test_text_and_record_have_both(plan):
    said, certificate = record_of(plan), plan.certificate
    assert said.peak_motor_power_w["M"] == pytest.approx(certificate.peak_motor_power[0])
    assert said.peak_brake_power_w["M"] == pytest.approx(certificate.peak_brake_power[0])
    (demands,) = (block for block in plan_blocks(plan) if isinstance(block, Table) and "demands" in block.title)
    shown = dict(zip((head for head, _ in demands.columns), demands.rows[0], strict=True))
    assert shown["power as motor"] == pytest.approx(certificate.peak_motor_power[0], rel=1e-3)
    assert shown["as brake"] == pytest.approx(certificate.peak_brake_power[0], rel=1e-3)
