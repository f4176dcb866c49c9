"""Overconstrained linkages and rods that spin, planned through whole turns."""

from functools import cache

import numpy as np
import pytest

import linkplan
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.compare.compare import run_figures, track
from tests.support.overconstrained import bennett, bricard, coupled_cranks, sarrus
from tests.support.spins import BUSH, DRAGGING, FIXED_BUSH, ON_A_BALL, ROUND, SPINS, TWO_BALLS, WISHBONE, WISHBONE_WITHOUT

NOISE = 1e-7
# What rounding of a file leaves open: links of a decimetre times the axes' error, a few times over [m].
GAP_M = {0.0: 1e-11, NOISE: 3e-7}
# A noisy mechanism's plan is a motion of its own equations as an exact one's is [deg]; without the exact derivative of the
# normal equations 1e-4.
INTEGRATED_DEG = 5e-6
# Least effort with axes that are off by NOISE against that without, relative.
SAME_EFFORT = 1e-6
# Tracking [deg] by a weak PD with feedforward, loops as soft as MuJoCo makes them by default. Measured 0.7.
TRACKED_DEG = 1.0
MODELS = {"bennett": bennett, "cranks": coupled_cranks, "bricard": bricard}
TRACKING = {"period_s": 1e-3, "kp": 2.0, "kd": 0.1, "duration_s": 2.0}


@cache
def planned(name: str, noise: float) -> Plan:
    """Return the plan of a full turn in a second; of Bricard's linkage, whose hinges swing, there and back.

    By `plan_motion`: `linkplan.plan` would begin a proof, which takes longer here than any time it is given.
    """
    model = MODELS[name](noise)
    asked = {"start_deg": {"H0": 0.0}, "goal_deg": {"H0": 40.0}} if name == "bricard" else {"turns": {FIRST[name]: 1}}
    return plan_motion(linkplan.Problem.periodic(model, duration_s=1.0, tracking=TRACKING, **asked)).require()


FIRST = {"bennett": "H0", "cranks": "O0", "bricard": "H0"}
NOISY = [pytest.param(name, marks=pytest.mark.hardest if name == "bricard" else pytest.mark.slow) for name in MODELS]
exact_and_noisy = pytest.mark.parametrize(
    ("name", "noise"),
    [
        *(pytest.param(name, 0.0, id=f"{name}, exact") for name in MODELS),
        *(pytest.param(*one.values, NOISE, id=f"{one.values[0]}, noisy", marks=one.marks) for one in NOISY),
    ],
)


@exact_and_noisy
def test_a_plan_of_a_turn_is_certified(name, noise):
    plan = planned(name, noise)
    assert plan.certificate.passed
    assert plan.certificate.closure_gap_m < GAP_M[noise]
    assert plan.certificate.integration_error_deg < INTEGRATED_DEG
    trajectory = plan.trajectory
    turned = 0.0 if name == "bricard" else 2 * np.pi
    assert trajectory.position[-1, -1, 0] - trajectory.position[0, 0, 0] == pytest.approx(turned, abs=1e-9)


@pytest.mark.parametrize("name", NOISY)
def test_rounding_of_the_axes_changes_the_effort_no_more_than_itself(name):
    assert planned(name, NOISE).objective == pytest.approx(planned(name, 0.0).objective, rel=SAME_EFFORT)


@exact_and_noisy
def test_a_turn_is_tracked_in_mujoco(name, noise):
    rollout = linkplan.track(planned(name, noise), "pd+ff").comparison.nominal["pd+ff"]
    assert rollout.stable
    assert np.degrees(np.abs(rollout.error_rad).max()) < TRACKED_DEG
    gone = 0.0 if name == "bricard" else 720.0
    assert np.degrees(rollout.position_rad[-1, 0] - rollout.position_rad[0, 0]) == pytest.approx(gone, abs=1.0)


def test_a_way_through_the_flat_pose_of_sarrus_linkage_is_named_before_any_solving():
    ways = {goal: {"start_deg": {"A1": 0.0}, "goal_deg": {"A1": goal}, "duration_s": 0.6} for goal in (-55.0, -20.0)}
    plan = plan_motion(linkplan.Problem.reach(sarrus(0.5), **ways[-55.0]))
    assert plan.status == "infeasible"
    assert "at A1 = -28.648 deg, the closure's rank falls from 4 to 2" in plan.message
    assert plan.history == ()
    coarse = {"intervals": 10, "tolerance_deg": 1e-2}
    assert plan_motion(linkplan.Problem.reach(sarrus(0.5), **ways[-20.0], mesh=coarse)).status == "optimal"


# Least effort with a bush left alone and with one fixed to the coupler, relative: what its drag and its moment of inertia
# take. Measured 7e-4; held at both ends it takes 15 times as much.
ALONE = 2e-3
# Least effort of a steered wheel, its tie rod on balls and on a universal joint, relative: its spin has inertia.
STEERED = 1e-4
# A joint that a plan puts at zero [rad].
PUT = 1e-9
# A crank in MuJoCo under LQR through soft loops [deg]. Measured 0.002 and 0.0007 (bush).
SPINS_TRACKED_DEG = 0.1


def planned_turn(model: str, motion: dict, **tables: dict) -> Plan:
    asked = {"mechanism": {"model": model, "solref": "stiff"}, "motion": motion, "objective": {"minimize": "effort"}}
    return plan_motion(Problem.from_tables("spin", asked | tables)).require()


@cache
def reach(model: str, bush: float | None = None) -> Plan:
    goal = {"O": 25.0} | ({} if bush is None else {"bush": bush})
    return planned_turn(model, {"kind": "reach", "start_deg": {"O": 0.0}, "goal_deg": goal, "duration_s": 0.3})


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
    assert np.degrees(np.abs(rollout.error_rad[:, 0]).max()) < SPINS_TRACKED_DEG
    assert np.degrees(np.abs(rollout.error_rad[:, 1]).max()) < 0.2 * abs(spun_deg(plan))
    assert run_figures(plan, rollout)["max_error_deg"] < SPINS_TRACKED_DEG, "what nobody steers is no tracking error"


@pytest.mark.slow
def test_a_spatial_four_bar_whose_rocker_is_hinged_by_two_connects_is_planned_through_half_a_turn():
    motion = {"kind": "reach", "start_deg": {"O": 0.0}, "goal_deg": {"O": 180.0}, "duration_s": 0.15}
    plan = planned_turn(TWO_BALLS, motion, mesh={"intervals": 20, "scheme": "radau-5"}, solver={"max_time_s": 3600})
    assert plan.certificate.passed
    assert not plan.problem.mechanism.dynamics.projected


@pytest.mark.slow
def test_a_spatial_four_bar_turns_for_ever_and_its_rod_spins_on():
    motion = {"kind": "periodic", "turns": {"O": 1}, "duration_s": 0.3}
    plan = planned_turn(ON_A_BALL, motion, mesh={"intervals": 40, "scheme": "radau-5"})
    spin = plan.trajectory.velocity[:, :, 1]
    assert abs(spin[-1, -1] - spin[0, 0]) < 1e-6 * np.abs(spin).max(), "its rate returns"
    turns = spun_deg(plan) / 360
    assert abs(turns - round(turns)) > 1e-3, "its angle need not"
    rollout = track(plan, "lqr")
    assert np.degrees(np.abs(rollout.error_rad[:, 0]).max()) < SPINS_TRACKED_DEG


@pytest.mark.hardest
def test_a_tie_rod_on_balls_steers_for_what_one_on_a_universal_joint_takes():
    """Where actuators have no leverage on a spin but rounding's, that is no unit of its equation."""
    motion = {"kind": "reach", "duration_s": 0.4, "start_m": {"rack": 0.0}, "goal_m": {"rack": 0.05}}
    motion |= {"start_deg": {"upper": 0.0}, "goal_deg": {"upper": 8.0}}
    with_balls, with_none = (
        planned_turn(model, motion, mesh={"tolerance_deg": 1e-4}) for model in (WISHBONE, WISHBONE_WITHOUT)
    )
    assert len(with_balls.problem.mechanism.passive_dofs) == 1
    assert abs(with_balls.objective / with_none.objective - 1) < STEERED


@pytest.mark.slow
def test_a_spin_that_drag_stops_within_a_microsecond_is_integrated():
    """No explicit step is longer than a few microseconds there: 20,000 evaluations do not reach an interval's end."""
    motion = {"kind": "reach", "start_deg": {"O": 0.0}, "goal_deg": {"O": 25.0}, "duration_s": 0.3}
    plan = planned_turn(DRAGGING, motion, mesh={"tolerance_deg": 1e-3})
    assert plan.certificate.integration_error_deg < 1e-3
    assert plan.certificate.integration_restarts == 0
