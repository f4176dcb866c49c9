"""Plans of servos: within their ranges of ctrl, at their clamps, and what forbids a motion."""

import mujoco
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize

import linkplan
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import control_excess
from linkplan.models.poses.assembly import close_at
from tests.support.bodies import SERVO_ARM, body_plan
from tests.support.linkages import GRIPPER
from tests.support.mechanisms import replaced

SERVO = """<mujoco><option gravity="0 0 -9.81"/><worldbody><body name="rod"><joint name="J" axis="0 1 0"/>
<inertial pos="0 0 -0.5" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>
<actuator><position name="s" joint="J" kp="100" ctrlrange="-{reach} {reach}" forcerange="-20 20"/></actuator></mujoco>"""
# An effort that is to be the clamp of a servo's force, relative: a motion enters there between two nodes.
AT_CLAMP = 1e-4
REACH = 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 60.0 }\nduration_s = 0.8\n'


@pytest.mark.slow
def test_a_servo_that_pulls_back_with_all_its_force_at_the_goal_is_planned_with():
    """At 60 deg any ctrl to 0.5 pulls back with the 20 N.m at which its forcerange ends: so it slows down and arrives."""
    plan = body_plan(SERVO.format(reach=0.5), REACH.replace("0.8", "0.5"), "mesh.intervals=10")
    assert plan.status == "optimal", plan.message
    end = plan.trajectory.duration_s
    beyond = plan.trajectory.position_at(np.linspace(0, end, 400))[:, 0] > 0.71
    assert np.any(beyond)
    assert np.abs(plan.trajectory.effort_at(np.linspace(0, end, 400))[beyond, 0] + 20).max() < 20 * AT_CLAMP


def test_a_servo_that_cannot_hold_back_gently_at_its_goal_is_said_at_once():
    """At 60 deg a ctrl of 0.5 asks for at least 100 (1.0472 - 0.5) N.m, of which 20 are given; the problem allows 10."""
    plan = body_plan(SERVO.format(reach=0.5), REACH, "limits.effort.s=[-10,10]")
    assert plan.status == "infeasible"
    assert plan.history == ()
    assert f"s on joint J would need a ctrl of {np.pi / 3 - 0.1:.4g} at the goal" in plan.message
    assert "its ctrlrange is -0.5 to 0.5" in plan.message


def test_a_joint_servos_plan_stays_within_the_ctrl_that_it_has():
    """ctrl = q + u / kp, in closed form: up to its end it is used, and no further."""

    def ctrl(plan) -> np.ndarray:
        time = plan.trajectory.dense_times(16)
        return plan.trajectory.position_at(time)[:, 0] + plan.trajectory.effort_at(time)[:, 0] / 100

    hurried = REACH.replace("0.8", "0.3")
    wide, tight = (body_plan(SERVO.format(reach=reach), hurried) for reach in (2.0, 0.9))
    assert (wide.status, tight.status) == ("optimal", "optimal"), tight.message
    assert np.abs(ctrl(wide)).max() > 0.92  # the range is in the way
    assert 0.9 - 1e-3 < np.abs(ctrl(tight)).max() < 0.9 + 1e-6
    assert tight.objective > wide.objective * 1.005


@pytest.mark.slow
def test_a_ctrl_range_that_forbids_the_motion_is_named():
    """A softer servo, u <= 22 (0.9 - q): its forcerange alone would do for 0.2248 s, its ctrl takes 0.2363 s."""
    softer = SERVO.replace('kp="100"', 'kp="22"').format(reach=0.9)
    plan = body_plan(softer, REACH.replace("0.8", "0.23"), "mesh.intervals=10")
    assert plan.status == "infeasible"
    assert "the ctrl of s would have to be" in plan.message
    assert "beyond its limit of 0.9" in plan.message
    assert plan.verdict.remedy["motion.duration_s"] > 0.23


GOAL = np.radians(25.0)
# Least time against the phase plane, relative: what a bound between nodes costs.
LEAST_TIME = 1e-4
# What a ctrl may overrun its range by, of the range: rounding.
CTRL = 1e-6


def gripper() -> Mechanism:
    """Return a gripper that stands still, its two fingers pulled apart by a position servo of 1 N and 0.6 of ctrl."""
    text = replaced(GRIPPER, '<joint name="lift" type="slide" axis="0 0 1" damping="1"/>', "")
    text = replaced(text, '<motor name="lift" joint="lift" ctrlrange="-20 20"/>', "")
    return linkplan.load_mechanism(replaced(text, 'kp="5"', 'kp="2"'))


def plan(mechanism: Mechanism, minimize: str, **motion):
    (joint,) = mechanism.independent_joints
    return linkplan.plan(
        linkplan.Problem.reach(
            mechanism, start_deg={joint.name: 0}, goal_deg={joint.name: np.degrees(GOAL)}, minimize=minimize, **motion
        )
    )


def overrun(found) -> float:
    """Return how far MuJoCo's ctrl is beyond the servo's range anywhere along a plan."""
    trajectory = found.trajectory
    time = np.linspace(0.0, trajectory.duration_s, 400)
    mechanism, position = found.problem.mechanism, trajectory.position_at(time)
    q = np.array([close_at(mechanism, s) for s in position])
    return float(control_excess(mechanism, q, trajectory.velocity_at(time), trajectory.effort_at(time)).max())


def quickest(mechanism: Mechanism) -> float:
    """Return the least time by the phase plane: all that forcerange and ctrlrange allow, one way and then the other."""
    (actuator,) = mechanism.actuators
    pull = float(mechanism.dynamics.effort_map(mechanism.home)) > 0

    def flow(most: bool):
        def rates(_t: float, y: np.ndarray) -> list[float]:
            q = close_at(mechanism, y[:1])
            length = 0.5 * (q[0] - q[3])  # the tendon's two cranks
            w = float(mechanism.dynamics.effort_map(q)) * y[1]
            ends = [2.0 * (c - length) - 0.05 * w for c in (-0.6, 0.6)]
            u = min(1.0, ends[1]) if most == pull else max(-1.0, ends[0])
            return [y[1], float(mechanism.dynamics.acceleration(q, y[1:], [u]))]

        return rates

    assert actuator.name == "grip"
    kept = {"rtol": 1e-8, "atol": 1e-10, "dense_output": True}

    def at_goal(_t: float, y: np.ndarray) -> float:
        return y[0] - GOAL

    def at_start(_t: float, y: np.ndarray) -> float:
        return y[0]

    at_goal.terminal = at_start.terminal = True
    ahead = scipy.integrate.solve_ivp(flow(True), (0, 0.2), [0.0, 0.0], events=at_goal, **kept)
    back = scipy.integrate.solve_ivp(flow(False), (0, -0.2), [GOAL, 0.0], events=at_start, **kept)

    def before_goal(s: float) -> float:
        return scipy.optimize.brentq(lambda x: back.sol(x)[0] - s, back.t[-1], 0.0, xtol=1e-14)

    def apart(time: float) -> float:
        s, v = ahead.sol(time)
        return float(v - back.sol(before_goal(s))[1])

    switch = scipy.optimize.brentq(apart, 1e-4, ahead.t[-1] * 0.999, xtol=1e-14)
    return float(switch - before_goal(ahead.sol(switch)[0]))


@pytest.mark.slow
def test_the_least_time_of_a_gripper_is_that_of_its_servos_range():
    mechanism = gripper()
    found = plan(mechanism, "time")
    assert found.certificate.passed, found.certificate.failures
    assert abs(found.duration_s / quickest(mechanism) - 1) < LEAST_TIME
    assert -1e-3 < overrun(found) < CTRL, "and the range binds"


@pytest.mark.slow
def test_a_quick_motion_of_least_effort_keeps_the_servos_range():
    found = plan(gripper(), "effort", duration_s=0.06)
    assert found.certificate.passed, found.certificate.failures
    assert -1e-3 < overrun(found) < CTRL, "and the range binds"


BEYOND = np.radians(30.0)
# The arm in MuJoCo [deg]: a switch time between two of its steps.
CARRIED_DEG = 0.05


@pytest.mark.parametrize("sign", [1, -1])
def test_a_servo_whose_whole_range_is_beyond_its_clamp_gives_the_clamp(sign):
    """All the way to 30 deg and back to rest in the least time of 1 N.m either way: 2 sqrt(angle I / 1 N.m)."""
    mechanism = linkplan.load_mechanism(SERVO_ARM)
    found = linkplan.plan(
        linkplan.Problem.reach(mechanism, start_deg={"O": 0}, goal_deg={"O": sign * np.degrees(BEYOND)}, minimize="time")
    )
    assert found.certificate.passed, found.certificate.failures
    assert abs(found.duration_s / (2 * np.sqrt(BEYOND * 0.02)) - 1) < LEAST_TIME
    assert overrun(found) < CTRL


def test_that_the_clamp_acts_there_is_mujocos_word():
    mechanism = linkplan.load_mechanism(SERVO_ARM)
    model = mechanism.model
    data = mujoco.MjData(model)
    for angle, ctrl in ((0.5, 0.3), (0.5, -0.3), (-0.5, 0.0)):
        data.qpos[0], data.ctrl[0] = angle, ctrl
        mujoco.mj_forward(model, data)
        clamp = -np.sign(angle)
        assert data.actuator_force[0] == clamp
        q, rest = np.array([[angle]]), np.zeros((1, 1))
        assert control_excess(mechanism, q, rest, np.array([[clamp]])).max() < CTRL
        assert control_excess(mechanism, q, rest, np.array([[0.9 * clamp]])).max() > 1e-3, "and nothing less"


def test_a_motion_beyond_the_range_is_run_in_mujoco_as_planned():
    mechanism = linkplan.load_mechanism(SERVO_ARM)
    found = linkplan.plan(linkplan.Problem.reach(mechanism, start_deg={"O": 0}, goal_deg={"O": 30.0}, minimize="time"))
    run = linkplan.track(found, "pd+ff", tracking={"kp": 0.0, "kd": 0.0, "period_s": 2e-4})
    (rollout,) = run.comparison.nominal.values()
    assert np.degrees(np.abs(rollout.error_rad).max()) < CARRIED_DEG
