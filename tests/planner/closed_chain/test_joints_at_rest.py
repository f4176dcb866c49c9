"""Joints that stand still while others move: their units are not those of their rounding."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.certificate.integration import integrate
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.closed_chain.transcribe import choose_scales
from linkplan.planner.plan.plan import Plan
from tests.support.bodies import body_plan, body_problem

INERTIA = 0.02
# Two wheels, of which the second stands still; damping makes both stable.
WHEELS = f"""<mujoco><worldbody>
  <body><joint name="A" damping="0.1"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 {INERTIA}"/></body>
  <body pos="1 0 0"><joint name="B" damping="0.1"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 {INERTIA}"/></body>
</worldbody><actuator>
  <motor name="at_A" joint="A" ctrlrange="-50 50"/><motor name="at_B" joint="B" ctrlrange="-50 50"/>
</actuator></mujoco>"""
ONE_MOVES = 'kind = "reach"\nstart_deg = { A = 0.0, B = 0.0 }\ngoal_deg = { A = 60.0, B = 0.0 }\nduration_s = 0.5\n'


def planned() -> Plan:
    plan = body_plan(WHEELS, ONE_MOVES)
    assert plan.status == "optimal", plan.message
    return plan


def test_the_unit_of_an_effort_at_rest_is_the_one_that_turns_its_joint_by_a_radian():
    problem = body_problem(WHEELS, ONE_MOVES)
    scales = choose_scales(problem, first_guess(problem, problem.start_pose()))
    assert scales.effort[1] == pytest.approx(INERTIA / 0.5**2, rel=0.01)
    assert scales.residual == pytest.approx(scales.effort)  # each motor turns one wheel


def test_a_stable_motion_beside_a_joint_at_rest_is_integrated_in_one_go():
    """Its speed, divided by the rounding that the joint at rest moves by, looked like the growth of an error."""
    plan = planned()
    wrong = replace(plan.trajectory, effort=1.1 * plan.trajectory.effort)
    judged = integrate(plan.problem.mechanism, wrong, 4.0, np.full(2, 1e-4))
    assert judged.position[0] > 1e-4
    assert judged.restarts == 0


def test_an_error_that_does_not_grow_costs_one_integration(monkeypatch):
    from linkplan.planner.certificate import integration

    calls, flow = [], integration.flow
    monkeypatch.setattr(integration, "flow", lambda *given, **named: calls.append(1) or flow(*given, **named))
    plan = planned()
    wrong = replace(plan.trajectory, effort=1.1 * plan.trajectory.effort)
    integrate(plan.problem.mechanism, wrong, 4.0, np.full(2, 1e-4))
    assert len(calls) <= len(plan.trajectory.breaks_s) - 1
