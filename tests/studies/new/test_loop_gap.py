"""Loops that the weight leaves closed in simulation, and the motion's own efforts open."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from linkplan.studies.check.new.first_motion import first_motion
from linkplan.studies.check.new.loop_gap import SOFT_IN_MOTION, home_gap, planned_gap, travel

# A light driven joint turns a heavy one by a coupling with constant impedance; no weight acts about vertical axes.
LIGHT, HEAVY, IMPEDANCE, TIME_CONSTANT_S = 0.01, 1.0, 0.9, 0.02
COUPLED = f"""
<mujoco><worldbody>
  <body><joint name="motor" axis="0 0 1" range="-90 90"/>
    <inertial pos="0 0 0" mass="1" diaginertia="{LIGHT} {LIGHT} {LIGHT}"/></body>
  <body pos="1 0 0"><joint name="wheel" axis="0 0 1" range="-90 90"/>
    <inertial pos="0 0 0" mass="1" diaginertia="{HEAVY} {HEAVY} {HEAVY}"/></body>
</worldbody>
<equality>
  <joint joint1="wheel" joint2="motor" solref="{TIME_CONSTANT_S} 1" solimp="{IMPEDANCE} {IMPEDANCE} 0.001"/>
</equality>
<actuator><motor joint="motor" ctrlrange="-2000 2000"/></actuator></mujoco>"""


def test_loops_that_a_motion_opens_are_stiff_with_its_plan():
    found = first_motion({"model": COUPLED}, lambda _: None)
    assert found.planned
    assert SOFT_IN_MOTION in found.changes
    assert found.tables["mechanism"]["solref"] == "stiff"
    assert found.plan is not None
    assert planned_gap(found.plan) < 0.01
    stiff = 2 * found.mechanism.model.opt.timestep
    np.testing.assert_allclose(found.mechanism.model.eq_solref[:, 0], stiff)


def test_the_gap_along_a_plan_is_that_of_the_coupling_s_effort():
    """Of one row: r = R f / (K d), with f = I_2 a, R = (1/I_1 + 1/I_2) (1 - d) / d and K = 1 / (d tau)^2."""
    found = first_motion({"model": COUPLED, "solref": "stiff"}, lambda _: None)
    assert found.plan is not None
    problem, trajectory = found.plan.problem, found.plan.trajectory
    model = copy.copy(problem.mechanism.model)
    model.eq_solref[:], model.eq_solimp[:, :3] = (TIME_CONSTANT_S, 1.0), (IMPEDANCE, IMPEDANCE, 0.001)
    softer = replace(problem, mechanism=replace(problem.mechanism, model=model))
    assert home_gap(softer.mechanism) == 0.0
    times = 0.5 * (trajectory.breaks_s[1:] + trajectory.breaks_s[:-1])
    a = float(np.abs(trajectory.acceleration_at(times)).max())
    R = (1 / LIGHT + 1 / HEAVY) * (1 - IMPEDANCE) / IMPEDANCE
    expected = R * HEAVY * a * (IMPEDANCE * TIME_CONSTANT_S) ** 2 / IMPEDANCE
    assert expected > 0.01
    assert planned_gap(replace(found.plan, problem=softer)) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(("range_deg", "time_constant_s", "stiff"), [(3, 0.01, True), (90, 0.004, False)])
def test_a_gap_is_small_beside_what_the_joints_travel(range_deg, time_constant_s, stiff):
    other = COUPLED.replace(f'"{TIME_CONSTANT_S} 1"', f'"{time_constant_s} 1"')
    model = other.replace("-90 90", f"-{range_deg} {range_deg}")
    found = first_motion({"model": model}, lambda _: None)
    assert found.planned
    assert (SOFT_IN_MOTION in found.changes) == stiff
    assert found.plan is not None
    start, goal = found.plan.problem.motion.start, found.plan.problem.motion.goal
    assert travel(found.plan) == pytest.approx(abs(goal[0] - start[0]), rel=1e-9)
    assert planned_gap(found.plan) < 0.01 * travel(found.plan)
