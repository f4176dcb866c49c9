"""Motions in phases against closed forms and independent results: jumps, hops, steps, and loads that are picked up."""

import numpy as np
import pytest

from linkplan.models.errors import LinkplanError
from linkplan.planner.problem.phases import PhasedProblem
from linkplan.planner.search.phases import plan_phases
from tests.support.phases import ARM, HIGHEST, HOPPER, LOAD, ROTOR, SOLE, TOE

# A body of 10 kg on a spring of 2,000 N/m that is locked in the air.
SPRING = """<mujoco model="hopper"><option gravity="0 0 -9.81"/><worldbody>
<body name="body" pos="0 0 0.5"><joint name="z" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass="10" diaginertia=".1 .1 .1"/>
<body name="foot" pos="0 0 -0.5"><joint name="leg" type="slide" axis="0 0 1" stiffness="2000"/>
<inertial pos="0 0 0" mass="1e-9" diaginertia="1e-9 1e-9 1e-9"/><site name="sole"/></body></body></worldbody>
<equality><joint name="lock" joint1="leg" polycoef="0 0 0 0 0"/></equality>
<actuator><motor name="leg" joint="leg" ctrlrange="-100 100" ctrllimited="true"/></actuator></mujoco>"""


def planned(model, phases, **tables):
    return plan_phases(PhasedProblem.of(model, phases, tables))


def radians(value):
    return float(np.degrees(value))


def picked_up(**approach):
    phases = [
        {"name": "approach", "start_deg": {"J": 0.0}, "goal_deg": {"J": radians(1.0)}, **approach},
        {"name": "carry", "payload": LOAD, "goal_deg": {"J": radians(2.0)}},
    ]
    return planned(ARM, phases, motion={"duration_s": 1.0})


def hopped():
    phases = [{"name": "push", "on": ["toe"], "start_m": {"leg": 0.0}}, {"name": "flight", "goal_m": {"leg": 0.3}}]
    return planned(HOPPER, phases, contacts=TOE, objective={"maximize": {"com_height": "apex"}})


def test_a_load_that_is_picked_up_on_the_move_takes_momentum_and_not_speed():
    plan = picked_up()
    assert plan.status == "optimal"
    assert plan.objective == pytest.approx(300.0, rel=1e-9)
    assert plan.plans[0].duration_s == pytest.approx(0.287140726, abs=1e-8)
    before, after = plan.plans[0].trajectory, plan.plans[1].trajectory
    speed = before.velocity_at(np.array([before.duration_s]))[0, 0]
    assert speed == pytest.approx(6.140727849, rel=1e-7)
    assert after.velocity_at(np.zeros(1))[0, 0] == pytest.approx(speed / 4, rel=1e-9)
    assert plan.junctions[0].energy_lost_j == pytest.approx(0.5 * speed**2 * (1 - 1 / 4), rel=1e-7)


def test_a_load_that_is_picked_up_at_rest_costs_more():
    plan = picked_up(rest=True)
    assert plan.objective == pytest.approx(972.0, rel=1e-9)
    assert [one.duration_s for one in plan.plans] == pytest.approx([1 / 3, 2 / 3], rel=1e-8)


def test_a_load_that_is_put_down_keeps_its_speed_to_itself():
    phases = [
        {"name": "carry", "payload": LOAD, "start_deg": {"J": 0.0}, "goal_deg": {"J": radians(1.0)}},
        {"name": "back", "goal_deg": {"J": radians(2.0)}},
    ]
    plan = planned(ARM, phases, motion={"duration_s": 1.0})
    first, second = (one.trajectory for one in plan.plans)
    left = first.velocity_at(np.array([first.duration_s]))[0, 0]
    assert left > 1.0
    assert second.velocity_at(np.zeros(1))[0, 0] == pytest.approx(left, rel=1e-9)
    assert plan.junctions[0].energy_lost_j == pytest.approx(0.0, abs=1e-9)


def test_a_hopper_jumps_as_high_as_its_closed_form():
    plan = hopped()
    assert plan.status == "optimal"
    assert plan.body.apex_m - plan.body.com_start_m[2] == pytest.approx(0.6813266365, abs=1e-8)
    assert plan.objective == plan.body.apex_m
    assert plan.plans[0].duration_s == pytest.approx(0.137405381, abs=1e-8)
    assert plan.plans[1].duration_s == pytest.approx(0.0202920267, abs=1e-8)
    assert plan.junctions[0].released == ("toe",)
    assert abs(plan.junctions[0].energy_lost_j) < 1e-9


def test_each_phase_is_an_ordinary_plan_that_can_be_proved():
    push, flight = hopped().plans
    assert push.problem.to_dict()["mechanism"]["stand"] == {"sole": [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]}
    assert push.with_proof().proof.passed
    assert flight.problem.mechanism.dof == 2


def test_a_passive_hopper_keeps_hopping_without_effort():
    phases = [
        {"name": "stance", "on": ["toe"], "open": ["lock"], "start_m": {"z": 0.0}, "start_speed_m_s": {"z": -1.0}},
        {"name": "flight"},
    ]
    plan = planned(SPRING, phases, contacts=TOE, motion={"repeat": True})
    assert plan.objective == pytest.approx(0.0, abs=1e-6)
    assert plan.plans[0].duration_s == pytest.approx(0.307911416546, abs=2e-8)
    assert plan.plans[1].duration_s == pytest.approx(0.203873598369, abs=1e-8)


def test_a_mass_without_a_place_is_carried_by_the_last_body():
    slide = ARM.replace('<joint name="J" axis="0 0 1"/>', '<joint name="J" type="slide" axis="1 0 0"/>')
    phases = [
        {"name": "approach", "start_m": {"J": 0.0}, "goal_m": {"J": 1.0}, "rest": True},
        {"name": "carry", "payload_kg": 3.0, "goal_m": {"J": 2.0}},
    ]
    assert planned(slide, phases, motion={"duration_s": 1.0}).objective == pytest.approx(972.0, rel=1e-9)
    two = slide.replace("</body></worldbody>", '</body><body name="other"><joint/><geom size="0.1"/></body></worldbody>')
    with pytest.raises(LinkplanError, match=r"phases\[1\].payload_kg needs mechanism.payload"):
        planned(two, phases)


def test_a_single_push_takes_off_at_its_end():
    # A rotor that its gear leaves behind: 6 N.m through 240.55 per metre lift 10 kg.
    J, N, T, m, g, d = 2e-4, 240.553752199, 6.0, 10.0, 9.81, 0.3
    plan = planned(ROTOR, [{"name": "push", "on": ["toe"], "start_m": {"leg": 0.0}}], contacts=SOLE, objective=HIGHEST)
    acceleration = (N * T - m * g) / (m + N**2 * J)
    assert plan.status == "optimal"
    assert plan.duration_s == pytest.approx(np.sqrt(2 * d / acceleration), abs=1e-8)
    assert plan.objective == pytest.approx(d + acceleration * d / g, abs=1e-8)
