"""The closed loop in MuJoCo on linkages with servos, tendons, welds and ball joints."""

from concurrent.futures import ThreadPoolExecutor

import mujoco
import numpy as np
import pytest
import scipy.integrate

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.rollout import ControlLoop, Rollout
from linkplan.controllers.trackers.lqr import lqr
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import follow
from tests.support.designs import designed
from tests.support.linkages import GRIPPER, RSSR
from tests.support.machines import run_alone
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
    reference = SampledReference(
        period_s=PERIOD_S,
        time_s=PERIOD_S * np.arange(20),
        pose_rad=pose,
        position_rad=s,
        velocity_rad_s=velocity,
        effort=effort,
        cycle=None,
    )
    reference = SampledReference(
        **{
            name: getattr(reference, name)[5:] for name in ("time_s", "pose_rad", "position_rad", "velocity_rad_s", "effort")
        },
        period_s=PERIOD_S,
        cycle=None,
    )
    rollout = run_alone(
        mechanism, reference, Scripted(efforts=np.zeros((15, 1))), ControlLoop(effort_limit=np.array([[-np.inf, np.inf]]))
    )
    assert np.abs(rollout.pose_rad[0] - pose[5]).max() < ROUNDING
    assert np.abs(rollout.velocity_rad_s[0] - velocity[5]).max() < ROUNDING
    assert len(rollout.pose_rad[0]) == mechanism.model.nv != mechanism.model.nq


def test_lqr_steers_the_crank_and_leaves_the_rods_spin_alone():
    mechanism = load_mechanism(RSSR)
    effort, _ = needed_effort(mechanism, mechanism.home[None], np.zeros((1, 2)), np.zeros((1, 2)))
    reference = standing(mechanism)
    steered = SampledReference(
        period_s=PERIOD_S,
        time_s=reference.time_s,
        pose_rad=reference.pose_rad,
        position_rad=reference.position_rad,
        velocity_rad_s=reference.velocity_rad_s,
        effort=np.tile(effort, (STEPS, 1)),
        cycle=None,
    )
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
