"""Limits of actuators: rates, powers, torque-speed lines and ctrl, against closed forms and MuJoCo."""

from dataclasses import replace

import casadi as ca
import mujoco
import numpy as np
import pytest
from scipy.optimize import brentq

import linkplan
from linkplan.models.poses.assembly import close_at
from linkplan.planner.limits.actuators import (
    ControlLimit,
    MotorLimit,
    PowerLimit,
    _ctrl,
    _ranged,
    _unit,
    clamped_allowance,
)
from linkplan.planner.limits.efforts import effort_rates
from linkplan.planner.limits.kinds import effort_bounds, margins_along, narrowed
from linkplan.planner.limits.samples import samples_of
from linkplan.planner.problem.instant import free_instant
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.trajectory import Trajectory
from tests.support.bodies import HINGE, SERVO_ARM, body_problem
from tests.support.motions import motion_along

BREAKS_S = np.array([0.0, 1.0, 3.0, 3.5])
JUMP = -20.0


def parabola_with_a_jump() -> Trajectory:
    """Return a motion with the effort t^2, and t^2 + JUMP after the second break."""
    begin, end = BREAKS_S[:-1], BREAKS_S[1:]
    effort = np.array([begin**2, begin * end, end**2])
    effort[:, 2] += JUMP
    still = np.zeros((3, 3, 1))
    return motion_along(BREAKS_S, still, effort=effort)


def test_the_rate_of_an_effort_is_its_derivative_in_every_interval_up_to_both_ends():
    time = np.array([0.0, 0.25, 0.9, 1.0, 2.0, 2.9, 3.1, 3.4, 3.5])
    rate, _ = effort_rates(parabola_with_a_jump(), time)
    assert rate[:, 0] == pytest.approx(2 * time, rel=1e-12, abs=1e-12)


def test_a_jump_is_an_infinite_rate_at_the_first_instant_after_it_alone():
    _, jumps = effort_rates(parabola_with_a_jump(), np.array([0.5, 1.0, 2.9, 3.1, 3.4]))
    np.testing.assert_array_equal(jumps[:, 0], [np.nan, np.nan, np.nan, -np.inf, np.nan])


def test_a_constant_effort_has_no_rate():
    still = np.zeros((3, 3, 1))
    trajectory = motion_along(BREAKS_S, still, effort=7.0)
    rate, jumps = effort_rates(trajectory, np.array([0.0, 1.0, 3.5]))
    assert not rate.any()
    assert np.isnan(jumps).all()


@pytest.mark.parametrize(("share", "jumps"), [(0.9e-7, False), (1.1e-7, True)])
def test_a_step_below_a_ten_millionth_of_the_largest_effort_is_no_jump(share, jumps):
    smooth = parabola_with_a_jump()
    effort = np.array(smooth.effort)
    effort[:, 2] -= JUMP
    effort[:, 2] += share * effort.max()
    _, found = effort_rates(replace(smooth, effort=effort), np.array([0.5, 3.1]))
    assert np.isposinf(found[1, 0]) == jumps


@pytest.mark.parametrize(
    ("low", "high", "unit"),
    [(-0.3, 0.5, 0.5), (-0.7, 0.5, 0.7), (-np.inf, 0.2, 0.2), (-np.inf, np.inf, 1.0), (0.0, 0.0, 1.0)],
)
def test_the_unit_of_a_servo_s_ctrl_is_the_larger_end_of_its_range(low, high, unit):
    (servo,) = crank(SERVO).mechanism.actuators
    assert _unit(replace(servo, control_lower=low, control_upper=high)) == unit


# A crank with a slider in a loop: one motor on the crank, one on the slider; a servo of 10 N.m/rad on the crank, clamped.
CRANK = """<mujoco><option gravity="0 0 0"/><worldbody>
<body><joint name="O" axis="0 1 0"/><inertial pos="0.1 0 0" mass="2" diaginertia="0.1 0.1 0.1"/>
<body pos="0.3 0 0"><joint name="A" axis="0 1 0"/><inertial pos="0.4 0 0" mass="1" diaginertia="0.05 0.05 0.05"/>
<site name="tip" pos="0.8 0 0"/></body></body>
<body pos="1.1 0 0"><joint name="P" type="slide" axis="1 0 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<site name="pin"/></body></worldbody><equality><connect site1="tip" site2="pin"/></equality>
<actuator>{actuators}</actuator></mujoco>"""
MOTORS = '<motor name="on_O" joint="O" ctrlrange="-9 9"/><motor name="on_P" joint="P" ctrlrange="-9 9"/>'
SERVO = '<position name="s" joint="O" kp="10" ctrlrange="-0.5 2" forcerange="-4 3"/>'


def crank(actuators: str, **limits) -> Problem:
    motion = {"start_deg": {"O": 20.0}, "goal_deg": {"O": 80.0}, "duration_s": 1.0}
    return Problem.reach(CRANK.format(actuators=actuators), **motion, limits=limits)


def test_at_every_instant_powers_are_limited_of_actuators_with_a_coordinate_and_with_levers():
    asked = crank(MOTORS, power_w={"on_O": 5.0, "on_P": 6.0})
    assert PowerLimit.of(asked) == [PowerLimit(0), PowerLimit(1)]
    assert PowerLimit.of(asked, enclosed=True) == [PowerLimit(0, 0), PowerLimit(1, None, (0,))]


def test_a_motor_s_row_is_the_share_of_its_line():
    mechanism = crank(MOTORS).mechanism
    at, (q, v, _, u, *_) = free_instant(mechanism)
    row = ca.Function("row", [q, v, u], [MotorLimit(1).rows.node(at, [1 / 6, 1 / 8])])
    pose = close_at(mechanism, np.array([0.5]))
    _, _, speed = np.array(mechanism.dynamics.velocity_map(pose)).ravel() * 2.0
    assert abs(speed) > 0.1
    assert float(row(pose, 2.0, [7.0, 3.0])) == pytest.approx(3 / 6 + speed / 8)


def test_a_servo_s_range_is_widened_at_both_ends_by_a_share_of_the_larger_one():
    asked = crank(SERVO)
    (wider,) = ControlLimit.relaxed(asked, 1.1).mechanism.actuators
    assert (wider.control_lower, wider.control_upper) == pytest.approx((-0.5 - 0.2, 2.0 + 0.2))


@pytest.mark.parametrize(("place", "effort", "allowed"), [(-0.9, 3.0, 1e-4 * 4 / 10), (0.1, 1.0, 0.0)])
def test_where_a_force_is_clamped_an_overrun_of_ctrl_by_a_ten_thousandth_of_the_clamp_is_allowed(place, effort, allowed):
    """At -0.9 rad 3 N.m are the clamp of every ctrl from -0.6 on, also of its least one, -0.5."""
    asked = crank(SERVO)
    still = np.full((2, 1, 1), place)
    trajectory = motion_along([0.0, 1.0], still, effort=effort, start_pose=asked.mechanism.home)
    assert clamped_allowance(asked, trajectory, 0) == pytest.approx(allowed)
    assert clamped_allowance(crank(MOTORS), replace(trajectory, effort=np.zeros((1, 1, 2))), 0) == 0.0


REACH = 'kind = "reach"\nstart_deg = { J = 0.0 }\ngoal_deg = { J = 90.0 }\nduration_s = 1.0\n'


def margin(*limit: str):
    """Return the margin of a limit along q = t^2, w = 2 t, u = 3 - t for a second."""
    problem = body_problem(HINGE, REACH, *limit)
    motion = motion_along([0.0, 1.0], [0.0, 0.0, 1.0], effort=[3.0, 2.0])
    samples = samples_of(problem, motion)
    _, found = margins_along(samples)
    return found


@pytest.mark.parametrize(("stall", "no_load", "most"), [(4.0, 4.0, 1.0), (4.0, 5.0, 0.9), (2.0, 10.0, 1.5), (5.0, 2.0, 1.4)])
def test_a_motors_line_is_the_sum_of_the_shares_of_its_stall_effort_and_no_load_speed(stall, no_load, most):
    line = margin(f"motors.motor={{stall_effort={stall},no_load_speed_deg_s={float(np.degrees(no_load))}}}")
    assert line.value == pytest.approx(most, rel=1e-9)
    assert line.kept is (most <= 1.0)


@pytest.mark.parametrize(("most", "left"), [(5.0, 1.0), (3.5, -0.5)])
def test_power_is_effort_times_speed(most, left):
    """u w = 2 t (3 - t) is 4 W at the end."""
    power = margin(f"limits.power_w.motor={most}")
    assert power.value == pytest.approx(4.0, rel=1e-9)
    assert power.left == pytest.approx(left, rel=1e-9)


@pytest.mark.parametrize("speed", [-3.0, -0.5, 0.0, 0.5, 3.0])
def test_every_limit_of_an_actuator_permits_the_efforts_up_to_those_at_a_speed_and_no_others(speed):
    line = "motors.motor={stall_effort=4.0,no_load_speed_deg_s=300.0}"
    problem = body_problem(HINGE, REACH, "limits.power_w.motor=3.0", line)
    ((low, high),) = effort_bounds(problem, np.array([[speed]]))[0]

    def is_permitted(effort: float) -> bool:
        share = abs(effort / 4.0 + speed / np.radians(300.0))
        within = problem.limits.effort[0, 0] <= effort <= problem.limits.effort[0, 1]
        return bool(within and abs(effort * speed) <= 3.0 and share <= 1.0)

    alone = effort_bounds(body_problem(HINGE, REACH), np.full((3, 1), speed))
    np.testing.assert_array_equal(alone, np.tile(problem.limits.effort, (3, 1, 1)))
    assert is_permitted(low + 1e-9)
    assert is_permitted(high - 1e-9)
    assert not is_permitted(low - 1e-9)
    assert not is_permitted(high + 1e-9)


GAIN, CTRL_HIGH, ANGLE = 50.0, 0.3, 0.5


@pytest.mark.parametrize(("share", "is_clamped"), [(5e-5, True), (5e-4, False)])
def test_beside_a_clamped_instant_an_effort_within_a_ten_thousandth_of_the_clamp_counts_as_clamped(share, is_clamped):
    (actuator,) = linkplan.load_mechanism(SERVO_ARM).actuators
    effort = np.array([-1.0, -1.0 + share, -1.0])
    ranged, bent = _ranged(actuator, ANGLE + effort / GAIN, effort, 3)
    assert bent.all()
    assert ranged[0] == pytest.approx(CTRL_HIGH, rel=1e-12)
    assert ranged[1] - CTRL_HIGH == pytest.approx(0.0 if is_clamped else share / GAIN, abs=1e-12)


def test_a_servo_s_ctrl_is_the_one_with_which_mujoco_gives_the_effort():
    """Of a lever arm's servo with every bias: effort = gain ctrl + b_0 + b_1 length + b_2 speed."""
    text = SERVO_ARM.replace(
        '<position name="servo" joint="O" kp="50" ctrlrange="-0.3 0.3" forcerange="-1 1"/>',
        '<general name="servo" joint="O" gear="2" gainprm="7" biastype="affine" biasprm="0.4 -30 -3" ctrlrange="-5 5"/>',
    )
    mechanism = linkplan.load_mechanism(text)
    (actuator,) = mechanism.actuators
    data = mujoco.MjData(mechanism.model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = 0.3, -0.7, 1.1
    mujoco.mj_forward(mechanism.model, data)
    (effort,), (length,), (speed,) = data.actuator_force, data.actuator_length, data.actuator_velocity
    assert _ctrl(actuator, effort, length, speed) == pytest.approx(1.1, rel=1e-12)


VOLTAGE_MOTOR = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="j" axis="0 1 0"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body></worldbody><actuator>
<dcmotor name="m" joint="j" motorconst="0.5" resistance="0.5" ctrlrange="-10 10" ctrllimited="true"/></actuator></mujoco>"""


def test_a_motor_with_a_limited_voltage_takes_the_least_time_of_its_back_emf():
    """Stall effort 10 N.m, no-load speed 20 rad/s, time constant 0.2 s: w' = (+-20 - w) / 0.2."""
    no_load, constant, turn = 20.0, 0.2, np.pi / 2

    def turned(driven: float) -> tuple[float, float]:
        speed = no_load * (1 - np.exp(-driven / constant))
        braked = constant * np.log1p(speed / no_load)
        return no_load * driven - constant * speed - no_load * braked + constant * speed, driven + braked

    driven = brentq(lambda t: turned(t)[0] - turn, 1e-3, 2.0, xtol=1e-14)
    ends = {"start_deg": {"j": 0.0}, "goal_deg": {"j": 90.0}}
    plan = plan_motion(Problem.reach(VOLTAGE_MOTOR, **ends, minimize="time"))
    assert plan.status == "optimal", plan.message
    assert plan.objective == pytest.approx(turned(driven)[1], rel=2e-8)


def test_a_share_narrows_both_ends_of_every_limit_that_the_phase_plane_follows_and_no_other():
    line = "motors.motor={stall_effort=4.0,no_load_speed_deg_s=300.0}"
    settings = ("limits.power_w.motor=3.0", "limits.speed_deg_s.J=90.0", "limits.effort.motor=[-4.0,-1.0]", line)
    problem = body_problem(HINGE, REACH, *settings, "limits.range_deg.J=[-10.0,200.0]")
    less, half = narrowed(problem, 0.5), 0.5 * np.array([[-1.0, 1.0]])
    np.testing.assert_allclose(less.limits.effort, [[-2.0, -1.5]])
    np.testing.assert_allclose(less.limits.power, 3.0 * half)
    np.testing.assert_allclose(less.limits.speed, np.radians(90.0) * half)
    np.testing.assert_array_equal(less.limits.position, problem.limits.position)
    assert less.motors[0].line == pytest.approx((2.0, np.radians(150.0)))
    one_sided = problem.varied(limits=replace(problem.limits, speed=np.array([[-np.inf, 2.0]])))
    np.testing.assert_allclose(narrowed(one_sided, 0.5).limits.speed, [[-np.inf, 1.0]])
