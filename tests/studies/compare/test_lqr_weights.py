"""Weights of LQR, and the gains that `tune` is recommended for."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

import linkplan
from linkplan.controllers.reference import SampledReference
from linkplan.controllers.sampling import sampling, simulated, spectral_radius
from linkplan.controllers.trackers.lqr import lqr
from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.along import felt_inertia
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.problem.settings import Tracking
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.compare.compare import compare
from linkplan.studies.compare.comparison_blocks import default_gains, servo_note
from linkplan.studies.compare.lqr_weights import scaled
from tests.support.designs import designed
from tests.support.parallel_ankle import soft_ankle

PERIOD_S = 2e-3
# A 60 kg slide, a heavy hinge beside it and a light one, each with its own servo; its gains are those of a mobile robot.
BESIDE = f"""<mujoco><option timestep="{PERIOD_S}" integrator="implicitfast" gravity="0 0 0"/><worldbody>
<body><joint name="base" type="slide" axis="1 0 0"/><inertial pos="0 0 0" mass="60" diaginertia="1 1 1"/></body>
<body pos="0 1 0"><joint name="arm" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>
<body pos="0 2 0"><joint name="wrist" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="1e-4 1e-4 1e-4"/></body>
</worldbody><actuator><position joint="base" kp="1e6" kv="5e4" forcerange="-600 600"/>
<position joint="arm" kp="2000" kv="100" forcerange="-100 100"/>
<position joint="wrist" kp="500" kv="50" forcerange="-50 50"/></actuator></mujoco>"""


def held() -> SampledReference:
    still, times = np.zeros((2, 3)), np.array([0.0, PERIOD_S])
    return SampledReference(
        period_s=PERIOD_S, time_s=times, pose_rad=still, position_rad=still, velocity_rad_s=still, effort=still, cycle=None
    )


def test_a_light_joint_does_not_weaken_the_gains_of_a_heavy_one():
    mechanism = load_mechanism(BESIDE)
    settings = scaled(Tracking(period_s=PERIOD_S), mechanism, np.zeros((1, 3)), np.array([600.0, 100.0, 50.0]))
    # Six periods at full effort: 50 N.m on 1e-4 kg m2 and 100 N.m on 1 kg m2.
    time = 6 * PERIOD_S
    assert settings.lqr_position_deg["wrist"] == pytest.approx(np.degrees(0.5 * 5e5 * time**2))
    assert settings.lqr_velocity_deg_s["wrist"] == pytest.approx(np.degrees(5e5 * time))
    assert settings.lqr_position_deg["arm"] == 1.0
    assert settings.lqr_velocity_deg_s["arm"] == 100.0
    assert (settings.lqr_position_m, settings.lqr_velocity_m_s) == (0.01, 1.0)
    position, velocity = settings.lqr_errors(mechanism.independent_joints)
    assert position == pytest.approx([0.01, np.radians(1.0), 0.5 * 5e5 * time**2])
    assert velocity == pytest.approx([1.0, np.radians(100.0), 5e5 * time])


def test_the_weights_of_a_link_without_inertia_stay_within_the_range_of_their_keys():
    joints = load_mechanism(BESIDE).independent_joints
    settings = Tracking(period_s=PERIOD_S).with_lqr_errors(joints, np.array([1.0, 1.0, 1e12]), PERIOD_S)
    assert settings.lqr_velocity_deg_s["wrist"] == 1e9
    assert settings.lqr_velocity_deg_s["arm"] == 100.0


def test_a_drive_behind_soft_loops_is_weighed_by_what_it_moves_at_first():
    mechanism = load_mechanism(soft_ankle(1e-6))
    unit, time = np.full(mechanism.n_u, 1e4), 6 * PERIOD_S
    settings = scaled(Tracking(period_s=PERIOD_S), mechanism, mechanism.home[None], unit)
    position, velocity = settings.lqr_errors(mechanism.independent_joints)
    steered = mechanism.actuated
    alone = 1e4 / felt_inertia(mechanism, mechanism.home)[steered]
    assert np.all(position[steered] >= 0.5 * alone * time**2 * (1 - 1e-9))
    assert np.all(velocity[steered] >= alone * time * (1 - 1e-9))


def test_errors_by_joint_are_one_for_each_hinge():
    joints = load_mechanism(BESIDE).independent_joints
    position, _ = Tracking(lqr_position_deg={"arm": 2.0, "wrist": 3.0}).lqr_errors(joints)
    assert np.degrees(position[1:]) == pytest.approx([2.0, 3.0])
    with pytest.raises(
        ProblemError, match=r"lqr_position_deg must have a value for each independent joint \(arm, wrist\), got arm"
    ):
        Tracking(lqr_position_deg={"arm": 2.0}).lqr_errors(joints)
    with pytest.raises(ProblemError, match=r"lqr_velocity_m_s must have a value for each independent joint \(none\), got O"):
        load_problem("knee-reach", ["tracking.lqr_velocity_m_s={ O = 2.0 }"])


def test_gains_for_servos_are_optimal_for_mujocos_own_steps():
    """The slide's servo takes 5e4 N.s/m times 2 ms as 100 kg more: an effort does 0.375 of what it does to 60 kg."""
    mechanism = load_mechanism(BESIDE)
    reference, unit = held(), np.array([600.0, 100.0, 50.0])
    law = lqr(designed(mechanism, reference, (0.01, 1.0, unit)))
    one = [values[:1] for values in (reference.pose_rad, reference.velocity_rad_s, reference.effort)]
    A, B, _ = (matrix[0] for matrix in simulated(mechanism, *one, sampling(mechanism, PERIOD_S)))
    assert B[3, 0] == pytest.approx(PERIOD_S / 160)
    Q, R = np.diag(np.repeat([0.01, 1.0], 3) ** -2.0), np.diag(unit**-2.0)
    P = scipy.linalg.solve_discrete_are(A, B, Q, R)
    assert law.gains[0] == pytest.approx(np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A), rel=1e-6, abs=1e-6)
    assert spectral_radius(A - B @ law.gains[0]) < 1.0


def test_servos_whose_damping_slows_a_step_down_are_named_with_what_is_left_of_an_effort():
    note = servo_note(load_mechanism(BESIDE))
    assert note is not None
    assert "leaves 0.1 % of a feedback's acceleration at wrist" in note  # 1e-4 of 1e-4 + 2 ms 50 N.m.s/rad
    assert servo_note(load_mechanism(BESIDE.replace("implicitfast", "Euler"))) is None


@pytest.mark.parametrize("integrator", ["implicitfast", "implicit", "Euler"])
def test_planned_efforts_of_servos_move_every_joint_as_planned(integrator):
    """Without what the plan's speed gains in a step, the slide lags by a fifth of its way and the arm by 0.3 deg."""
    mechanism = load_mechanism(BESIDE.replace("implicitfast", integrator))
    still, goal = {"arm": 0.0, "wrist": 0.0}, {"arm": 30.0, "wrist": 30.0}
    problem = Problem.reach(
        mechanism, start_deg=still, goal_deg=goal, start_m={"base": 0.0}, goal_m={"base": 0.2}, duration_s=1
    )
    runs = compare(plan_motion(problem), None).nominal
    error = np.abs(runs["pd+ff"].error_rad).max(axis=0)
    assert error[0] < 0.002 * 0.2
    assert error[1] < np.radians(0.02)
    assert np.abs(runs["lqr"].error_rad).max() < 1e-3


ARM = """<mujoco><worldbody><body><joint name="J" axis="0 1 0"/><geom size=".05" pos="0 0 -.3" mass="1"/>{}</body>
</worldbody><actuator>{}</actuator></mujoco>"""
LOAD = """<body pos="0 0 -.3"><joint name="K" axis="0 1 0" damping=".1"/>
<geom size=".05" pos="0 0 -.3" mass=".2" contype="0" conaffinity="0"/></body>"""
MOTOR = '<motor name="{}" joint="J" ctrlrange="-10 10"/>'
CASES = {
    "one motor of one freedom": ARM.format("", MOTOR.format("M")),
    "two motors of one freedom": ARM.format("", MOTOR.format("M") + MOTOR.format("N")),
    "one motor of two freedoms": ARM.format(LOAD, MOTOR.format("M")),
}


@pytest.mark.slow
@pytest.mark.parametrize("text", CASES.values(), ids=CASES)
def test_tune_is_recommended_and_answers(text):
    mechanism = linkplan.load_mechanism(text)
    names = [joint.name for joint in mechanism.independent_joints]
    ends = {"start_deg": dict.fromkeys(names, 0.0), "goal_deg": dict.fromkeys(names, 0.0) | {"J": 10.0}}
    problem = linkplan.Problem.reach(mechanism, **ends, duration_s=2.0)
    comparison = compare(linkplan.plan(problem).require(), None, asked=["pd"])
    (note,) = default_gains(comparison)
    assert "linkplan tune" in note
    assert linkplan.tune(problem, bandwidth_hz=2.0, at_deg=[ends["start_deg"]]).tracking["kp"]


@pytest.mark.slow
def test_tune_is_not_recommended_where_no_pose_is_held():
    """The least effort of the motor is more than the weight needs anywhere."""
    problem = linkplan.Problem.reach(
        linkplan.load_mechanism(CASES["one motor of one freedom"]),
        start_deg={"J": 0.0},
        goal_deg={"J": 10.0},
        duration_s=2.0,
    )
    comparison = compare(linkplan.plan(problem).require(), None, asked=["pd"])
    weak = problem.replace(limits={"effort": {"M": [0.9, 1.0]}})
    (note,) = default_gains(replace(comparison, plan=replace(comparison.plan, problem=weak)))
    assert "linkplan tune" not in note
    assert "needs effort to both sides" in note
