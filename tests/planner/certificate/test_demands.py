"""What a motion demands of its actuators, against sums over dense samples and the energy of a mass."""

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from tests.support.plans import planned

SCREW = """<mujoco><option gravity="0 0 0"/>
  <worldbody><body><joint name="X" type="slide" axis="1 0 0"/><geom type="box" size=".1 .1 .1" mass="2"/></body></worldbody>
  <actuator><motor name="F" joint="X" ctrlrange="-100 100"/></actuator>
</mujoco>"""


def test_the_demands_of_the_knee_are_those_of_dense_samples():
    plan = planned("knee-reach")
    (found,) = plan.demands()
    table = plan.sample(np.linspace(0.0, plan.trajectory.duration_s, 40001))
    effort, speed = table.effort["act_O"], table.speed_deg_s["O"]
    power = effort * np.radians(speed)
    step = table.time_s[1]
    assert (found.actuator, found.effort_unit, found.speed_unit) == ("act_O", "N.m", "deg/s")
    assert found.peak_effort == pytest.approx(np.abs(effort).max(), rel=1e-4)
    assert found.peak_effort == pytest.approx(plan.certificate.peak_effort[0], rel=1e-4)
    assert found.rms_effort == pytest.approx(np.sqrt(np.mean(effort**2)), rel=1e-4)
    assert found.rms_effort**2 * plan.trajectory.duration_s == pytest.approx(plan.objective, rel=1e-6)
    assert found.peak_speed == pytest.approx(np.abs(speed).max(), rel=1e-4)
    assert found.peak_motor_power_w == pytest.approx(power.max(), rel=1e-3)
    assert found.peak_brake_power_w == pytest.approx(-power.min(), rel=1e-3)
    assert found.energy_given_j == pytest.approx(np.maximum(power, 0).sum() * step, rel=1e-3)
    assert found.energy_taken_j == pytest.approx(np.maximum(-power, 0).sum() * step, rel=1e-3)


def test_a_mass_takes_its_kinetic_energy_and_gives_it_back():
    """2 kg over 1 m in 1 s with least squared effort: the speed is 6 t (1 - t) m/s, the force 24 (1/2 - t) N."""
    problem = Problem.reach(load_mechanism(SCREW), start_m={"X": 0.0}, goal_m={"X": 1.0}, duration_s=1.0)
    (found,) = plan_motion(problem).demands()
    assert (found.effort_unit, found.speed_unit) == ("N", "m/s")
    assert found.peak_effort == pytest.approx(12.0, rel=1e-6)
    assert found.rms_effort == pytest.approx(np.sqrt(48.0), rel=1e-6)
    assert found.peak_speed == pytest.approx(1.5, rel=1e-3)
    assert found.energy_given_j == pytest.approx(0.5 * 2 * 1.5**2, rel=1e-5)
    assert found.energy_taken_j == pytest.approx(0.5 * 2 * 1.5**2, rel=1e-5)
    assert found.peak_motor_power_w == pytest.approx(72 * np.sqrt(3) / 36 * 2, rel=1e-3)
