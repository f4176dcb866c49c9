"""Spins of links in loops: left to themselves, in plans, certificates and MuJoCo alike."""

from functools import cache

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.compare.compare import run_figures, track
from tests.support.spins import BUSH, DRAGGING, FIXED_BUSH, ON_A_BALL, ROUND, SPINS, TWO_BALLS, WISHBONE, WISHBONE_WITHOUT

# Least effort with a bush left alone and with one fixed to the coupler, relative: what its drag and its moment of inertia
# take. Measured 7e-4; held at both ends it takes 15 times as much.
ALONE = 2e-3
# Least effort of a steered wheel, its tie rod on balls and on a universal joint, relative: its spin has inertia.
STEERED = 1e-4
# A joint that a plan puts at zero [rad].
PUT = 1e-9
# A crank in MuJoCo under LQR, and a spin that nobody steers, through soft loops [deg]. Measured 0.002 and 0.0007 (bush).
TRACKED_DEG, SPUN_DEG = 0.1, 2.0


def planned(model: str, motion: dict, **tables: dict) -> Plan:
    asked = {"mechanism": {"model": model, "solref": "stiff"}, "motion": motion, "objective": {"minimize": "effort"}}
    return plan_motion(Problem.from_tables("spin", asked | tables)).require()


@cache
def reach(model: str, bush: float | None = None) -> Plan:
    goal = {"O": 25.0} | ({} if bush is None else {"bush": bush})
    return planned(model, {"kind": "reach", "start_deg": {"O": 0.0}, "goal_deg": goal, "duration_s": 0.3})


def spun_deg(plan: Plan, column: int = 1) -> float:
    return float(np.degrees(plan.trajectory.position[-1, -1, column] - plan.trajectory.position[0, 0, column]))


@pytest.mark.parametrize("name", ROUND)
def test_spins_are_found_whatever_joints_they_are_made_of(name):
    mechanism = load_mechanism(ROUND[name])
    assert [mechanism.joints[i].name for i in mechanism.passive_dofs] == [SPINS[name]]
    assert mechanism.cyclic.tolist() == [False, True]


def test_an_actuator_or_a_spring_on_it_makes_a_spin_none():
    driven = BUSH.replace("<actuator>", '<actuator><motor name="act_bush" joint="bush" ctrlrange="-1 1"/>')
    sprung = BUSH.replace('<joint name="bush" ', '<joint name="bush" stiffness="0.1" springref="0.3" ')
    heavy = BUSH.replace('<site name="B1"/></body>', '<site name="B1"/><geom pos="0.02 0 0"/></body>')
    assert load_mechanism(BUSH).passive_dofs != ()
    for text in (driven, sprung, heavy):
        assert text != BUSH
        assert load_mechanism(text).passive_dofs == ()


def test_a_bush_on_the_loops_own_pin_is_left_to_spin_and_costs_next_to_nothing():
    assert abs(reach(BUSH).objective / reach(FIXED_BUSH).objective - 1) < ALONE
    assert abs(spun_deg(reach(BUSH))) > 1, "it has turned meanwhile"


@pytest.mark.slow
def test_a_bush_that_the_goal_names_is_steered_and_that_is_dear():
    asked = reach(BUSH, 0.0)
    assert abs(asked.trajectory.position[-1, -1, 1]) < PUT
    assert asked.objective > 5 * reach(BUSH).objective


def test_what_spins_in_the_plan_spins_as_much_in_mujoco():
    plan = reach(BUSH)
    rollout = track(plan, "lqr")
    assert np.degrees(np.abs(rollout.error_rad[:, 0]).max()) < TRACKED_DEG
    assert np.degrees(np.abs(rollout.error_rad[:, 1]).max()) < 0.2 * abs(spun_deg(plan))
    assert run_figures(plan, rollout)["max_error_deg"] < TRACKED_DEG, "what nobody steers is no tracking error"


@pytest.mark.slow
def test_a_spatial_four_bar_is_planned_and_tracked_through_a_turn():
    motion = {"kind": "reach", "start_deg": {"O": 0.0}, "goal_deg": {"O": 360.0}, "duration_s": 0.3}
    plan = planned(ON_A_BALL, motion, mesh={"intervals": 40, "scheme": "radau-5"}, tracking={"period_s": 1e-4})
    assert plan.certificate.passed
    rollout = track(plan, "lqr")
    assert np.degrees(rollout.position_rad[-1, 0]) > 359
    assert np.degrees(np.abs(rollout.error_rad[:, 0]).max()) < TRACKED_DEG
    assert np.degrees(np.abs(rollout.error_rad[:, 1]).max()) < SPUN_DEG
    assert abs(spun_deg(plan)) > 10


@pytest.mark.slow
def test_a_spatial_four_bar_whose_rocker_is_hinged_by_two_connects_is_planned_through_half_a_turn():
    motion = {"kind": "reach", "start_deg": {"O": 0.0}, "goal_deg": {"O": 180.0}, "duration_s": 0.15}
    plan = planned(TWO_BALLS, motion, mesh={"intervals": 20, "scheme": "radau-5"}, solver={"max_time_s": 3600})
    assert plan.certificate.passed
    assert not plan.problem.mechanism.dynamics.projected


@pytest.mark.slow
def test_a_spatial_four_bar_turns_for_ever_and_its_rod_spins_on():
    motion = {"kind": "periodic", "turns": {"O": 1}, "duration_s": 0.3}
    plan = planned(ON_A_BALL, motion, mesh={"intervals": 40, "scheme": "radau-5"})
    spin = plan.trajectory.velocity[:, :, 1]
    assert abs(spin[-1, -1] - spin[0, 0]) < 1e-6 * np.abs(spin).max(), "its rate returns"
    turns = spun_deg(plan) / 360
    assert abs(turns - round(turns)) > 1e-3, "its angle need not"
    rollout = track(plan, "lqr")
    assert np.degrees(np.abs(rollout.error_rad[:, 0]).max()) < TRACKED_DEG


@pytest.mark.long
def test_a_tie_rod_on_balls_steers_for_what_one_on_a_universal_joint_takes():
    """Where actuators have no leverage on a spin but rounding's, that is no unit of its equation."""
    motion = {"kind": "reach", "duration_s": 0.4, "start_m": {"rack": 0.0}, "goal_m": {"rack": 0.05}}
    motion |= {"start_deg": {"upper": 0.0}, "goal_deg": {"upper": 8.0}}
    with_balls, with_none = (planned(model, motion, mesh={"tolerance_deg": 1e-4}) for model in (WISHBONE, WISHBONE_WITHOUT))
    assert len(with_balls.problem.mechanism.passive_dofs) == 1
    assert abs(with_balls.objective / with_none.objective - 1) < STEERED


@pytest.mark.slow
def test_a_spin_that_drag_stops_within_a_microsecond_is_integrated():
    """No explicit step is longer than a few microseconds there: 20,000 evaluations do not reach an interval's end."""
    motion = {"kind": "reach", "start_deg": {"O": 0.0}, "goal_deg": {"O": 25.0}, "duration_s": 0.3}
    plan = planned(DRAGGING, motion, mesh={"tolerance_deg": 1e-3})
    assert plan.certificate.integration_error_deg < 1e-3
    assert plan.certificate.integration_restarts == 0
