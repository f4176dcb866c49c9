"""Simulations of linkages with servos and ball joints, poses that laws close, and efforts within a servo's range."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import casadi as ca
import mujoco
import numpy as np
import pytest
import scipy.integrate

from linkplan.controllers.imperfections.servos import ServoInversion
from linkplan.controllers.rollout import ControlLoop, Rollout
from linkplan.controllers.trackers.computed_torque import ComputedTorque
from linkplan.controllers.trackers.lqr import lqr
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import follow
from linkplan.models.reduction.closing import closed_near
from tests.support.designs import designed
from tests.support.linkages import GRIPPER, RSSR
from tests.support.machines import reach, run_alone
from tests.support.mechanisms import replaced
from tests.support.scripted import PERIOD_S, STEPS, Scripted, hard, standing, wave
from tests.support.tolerances import UNIT_VECTOR
from tests.support.tolerances_planner import ROLLOUT_GAP_M, ROUNDING, SERVO_AS_MOTOR

# MuJoCo's Euler step of 1e-5 s against the reduced model integrated to 1e-9 over 0.05 s, loops as hard as that step allows
# [rad or m]: first order in the step. Measured 1e-5.
SIMULATED = 1e-4


def scripted(mechanism: Mechanism, efforts: np.ndarray, limit: float = np.inf) -> Rollout:
    limits = np.tile([-limit, limit], (mechanism.n_u, 1))
    return run_alone(
        mechanism, standing(mechanism, len(efforts)), Scripted(efforts=efforts), ControlLoop(effort_limit=limits)
    )


def integrated(mechanism: Mechanism, efforts: np.ndarray) -> np.ndarray:
    """Return the poses (n, n_q) at the control instants of the reduced model under held efforts."""
    n_q = mechanism.n_q
    state, poses = np.concatenate([mechanism.home, np.zeros(mechanism.dof)]), []
    for u in efforts:
        poses.append(state[:n_q])

        def rate(_: float, y: np.ndarray, u=u) -> np.ndarray:
            return np.concatenate([np.array(x).ravel() for x in mechanism.dynamics.flow(y[:n_q], y[n_q:], u)])

        state = scipy.integrate.solve_ivp(rate, (0, PERIOD_S), state, rtol=1e-9, atol=1e-10).y[:, -1]
    return np.array(poses)


# The grip as a servo on a tendon, and the same as a motor.
SERVO = GRIPPER.replace('forcerange="-1 1" ctrlrange="-0.6 0.6"', "")
MOTOR = replaced(
    GRIPPER,
    '<position name="grip" tendon="split" kp="5" kv="0.05" forcerange="-1 1" ctrlrange="-0.6 0.6"/>',
    '<motor name="grip" tendon="split"/>',
)


@pytest.mark.parametrize("integrator", ["Euler", "RK4"])
def test_a_servo_gives_the_effort_that_a_motor_would(integrator):
    servo, motor = (load_mechanism(hard(text, 1e-4, integrator)) for text in (SERVO, MOTOR))
    assert servo.actuators[1].is_servo
    assert not motor.actuators[1].is_servo
    efforts = wave(servo, 0.05) * [100.0, 1.0]
    first, second = scripted(servo, efforts), scripted(motor, efforts)
    assert np.abs(np.ptp(first.position_rad, axis=0)).min() > 1e-3, "both coordinates move"
    assert np.abs(first.pose_rad - second.pose_rad).max() < SERVO_AS_MOTOR
    assert np.abs(first.applied - efforts).max() < ROUNDING


def test_servos_that_run_in_threads_of_their_own_do_not_meddle_with_each_other():
    mechanism = load_mechanism(hard(GRIPPER, 1e-4, "implicitfast"))
    efforts = [wave(mechanism, size) for size in (0.02, 0.05, 0.08, 0.1)]
    alone = [scripted(mechanism, each) for each in efforts]
    with ThreadPoolExecutor(len(efforts)) as threads:
        together = list(threads.map(lambda each: scripted(mechanism, each), efforts))
    for one, other in zip(alone, together, strict=True):
        np.testing.assert_array_equal(other.pose_rad, one.pose_rad)
    assert np.ptp([run.pose_rad[-1, 0] for run in alone]) > 1e-4


@pytest.mark.slow
@pytest.mark.parametrize(("name", "text", "size"), [("gripper", SERVO, 0.02), ("rssr", RSSR, 0.1)])
def test_the_simulation_follows_the_reduced_model(name, text, size):
    mechanism = load_mechanism(hard(text))
    efforts = wave(mechanism, size)
    if name == "gripper":
        efforts = efforts * [200.0, 1.0]
    rollout, expected = scripted(mechanism, efforts), integrated(mechanism, efforts)
    assert rollout.finite
    assert np.ptp(rollout.position_rad[:, 0]) > 20 * SIMULATED, "it moves"
    assert np.abs(rollout.pose_rad - expected).max() < SIMULATED
    assert rollout.gap_m.max() < ROLLOUT_GAP_M


def test_a_run_with_a_ball_joint_starts_where_its_reference_does():
    mechanism = load_mechanism(RSSR)
    s = mechanism.home[mechanism.independent] + np.outer(np.linspace(0, 1, 20), [0.3, 0.2])
    pose, velocity = follow(mechanism, s), np.tile([1.5, 1.0], (20, 1))
    effort, _ = needed_effort(mechanism, pose, velocity, np.zeros((20, 2)))
    moving = {"pose_rad": pose[5:], "position_rad": s[5:], "velocity_rad_s": velocity[5:], "effort": effort[5:]}
    loop = ControlLoop(effort_limit=np.array([[-np.inf, np.inf]]))
    rollout = run_alone(mechanism, replace(standing(mechanism, 15), **moving), Scripted(efforts=np.zeros((15, 1))), loop)
    assert np.abs(rollout.pose_rad[0] - pose[5]).max() < ROUNDING
    assert np.abs(rollout.velocity_rad_s[0] - velocity[5]).max() < ROUNDING
    assert len(rollout.pose_rad[0]) == mechanism.model.nv != mechanism.model.nq


def test_lqr_steers_the_crank_and_leaves_the_rods_spin_alone():
    mechanism = load_mechanism(RSSR)
    effort, _ = needed_effort(mechanism, mechanism.home[None], np.zeros((1, 2)), np.zeros((1, 2)))
    steered = replace(standing(mechanism), effort=np.tile(effort, (STEPS, 1)))
    tracker = lqr(designed(mechanism, steered, (0.02, 2.0, np.array([2.0]))))
    assert np.all(tracker.gains[:, :, [1, 3]] == 0)
    assert np.all(tracker.gains[:, 0, 0] > 0)
    rollout = run_alone(mechanism, steered, tracker, ControlLoop(effort_limit=mechanism.effort_limit))
    assert np.abs(rollout.position_rad[:, 0] - mechanism.home[0]).max() < np.radians(1.0)


def test_a_playback_pose_is_mujocos():
    mechanism = load_mechanism(RSSR)
    rollout = scripted(mechanism, wave(mechanism, 0.1, 20))
    qpos = mechanism.qpos_of(rollout.pose_rad[-1])
    data = mujoco.MjData(mechanism.model)
    data.qpos[:] = qpos
    mujoco.mj_forward(mechanism.model, data)
    assert np.abs(np.linalg.norm(qpos[1:5]) - 1) < UNIT_VECTOR
    ends = [data.site("ball").xpos, data.site("socket").xpos]
    assert np.abs(np.linalg.norm(ends[0] - ends[1]) - rollout.gap_m[-1]) < ROUNDING


@pytest.mark.parametrize("by", [-0.6, 0.4, 0.8])
def test_a_pose_is_closed_on_the_branch_of_one_far_away(by):
    mechanism = load_mechanism("optimus-knee")
    near, s = ca.MX.sym("near", mechanism.n_q), ca.MX.sym("s", 1)
    close = ca.Function("close", [near, s], list(closed_near(mechanism.dynamics, near, s)))
    position = mechanism.home[mechanism.independent] + by
    q, gap = (np.array(value).ravel() for value in close(mechanism.home, position))
    way = mechanism.home[mechanism.independent] + by * np.linspace(0.0, 1.0, 50)[:, None]
    assert q == pytest.approx(follow(mechanism, way, mechanism.home)[-1], abs=1e-7)
    assert gap[0] < 1e-7


@pytest.mark.parametrize(("gap_m", "measured"), [(3e-7, True), (3e-6, False)])
def test_computed_torque_answers_for_the_reference_s_pose_where_the_loop_leaves_a_gap(gap_m, measured):
    mechanism, reference = reach()
    near, s, v, a, u = (ca.MX.sym(name, n) for name, n in (("near", mechanism.n_q), ("s", 1), ("v", 1), ("a", 1), ("u", 1)))
    tracker = ComputedTorque(
        reference=reference, acceleration=np.zeros((reference.n, 1)), stiffness=0.0, damping=0.0,
        law=ca.Function("law", [near, s, v, a, u], [s, ca.MX(gap_m)]),
    )  # fmt: skip
    there = reference.position_rad[3] + 0.2
    assert tracker.effort(3, there, reference.velocity_rad_s[3]) == pytest.approx(
        there if measured else reference.position_rad[3]
    )


GAINS, BIASES = np.array([3.0, 0.5, -0.4]), np.array([0.2, -2.0, -0.7])
LENGTH, RATE = 0.6, 1.5


def of_state(coefficients: np.ndarray) -> float:
    return float(coefficients @ [1.0, LENGTH, RATE])


def controls(effort: float, *, motor: bool = False) -> tuple[float, float]:
    servo = ServoInversion(
        gains=GAINS[None], biases=BIASES[None], low=np.array([-1.0]), high=np.array([1.5]), motor=np.array([motor])
    )
    ctrl, given = servo.controls(np.array([[effort]]), np.array([[LENGTH]]), np.array([[RATE]]))
    return float(ctrl[0, 0]), float(given[0, 0])


@pytest.mark.parametrize("ctrl", [-0.9, 0.0, 1.4])
def test_within_its_range_the_ctrl_gives_the_effort(ctrl):
    effort = of_state(GAINS) * ctrl + of_state(BIASES)
    assert controls(effort) == (pytest.approx(ctrl, abs=1e-12), effort)


@pytest.mark.parametrize(("excess", "end"), [(10.0, 1.5), (-10.0, -1.0)])
def test_beyond_its_range_the_effort_is_that_of_the_range_s_end(excess, end):
    given = of_state(GAINS) * end + of_state(BIASES)
    assert controls(given + excess) == (end, pytest.approx(given))
    assert controls(given + excess, motor=True) == (pytest.approx(given), pytest.approx(given))


@pytest.mark.parametrize(("share", "steers"), [(5e-9, True), (5e-10, False)])
def test_a_gain_below_a_billionth_of_its_own_at_home_counts_as_none(share, steers):
    """The gain g0 (1 - l) vanishes at a length of one, where no ctrl changes the effort."""
    servo = ServoInversion(
        gains=np.array([[3.0, -3.0, 0.0]]), biases=np.array([[0.2, -2.0, 0.0]]),
        low=np.array([-np.inf]), high=np.array([np.inf]), motor=np.array([False]),
    )  # fmt: skip
    length = 1.0 - share
    bias = 0.2 - 2.0 * length
    ctrl, given = servo.controls(np.array([[bias + 3.0 * share]]), np.array([[length]]), np.zeros((1, 1)))
    assert ctrl[0, 0] == pytest.approx(1.0 if steers else 0.0, rel=1e-5)
    assert given[0, 0] == (bias + 3.0 * share if steers else pytest.approx(bias, abs=1e-12))
