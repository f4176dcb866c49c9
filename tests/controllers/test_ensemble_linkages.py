"""Many simulations of servos and ball joints together are those of the single loop, one by one."""

import mujoco
import numpy as np
import pytest

from linkplan.controllers.imperfections.imperfections import Drives, Imperfections, Machine, Start
from linkplan.controllers.rollout import ControlLoop
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import close_at
from tests.support.linkages import GRIPPER, RSSR
from tests.support.machines import run_alone, run_machines
from tests.support.mechanisms import replaced
from tests.support.scripted import PERIOD_S, Scripted, hard, standing, wave
from tests.support.tolerances_planner import ROUNDING, SERVO_AS_MOTOR

CUT = replaced(GRIPPER, 'ctrlrange="-0.6 0.6"', 'ctrlrange="-0.01 0.01"')
AS_MODELLED = (Imperfections(),) * 3


def both(text, efforts, machines=AS_MODELLED, limit=50.0):
    """Return the single run and an ensemble's of scripted efforts from home."""
    mechanism = load_mechanism(text)
    loop = ControlLoop(effort_limit=np.tile([-limit, limit], (mechanism.n_u, 1)))
    reference, law = standing(mechanism, len(efforts)), Scripted(efforts=efforts)
    return run_alone(mechanism, reference, law, loop), run_machines(mechanism, reference, law, loop, machines)


@pytest.mark.parametrize("integrator", ["Euler", "RK4"])
@pytest.mark.parametrize("text", [GRIPPER, RSSR], ids=["servo", "ball"])
def test_a_nominal_machine_runs_as_alone(text, integrator):
    text = hard(text, 1e-4, integrator)
    mechanism = load_mechanism(text)
    efforts = wave(mechanism, 0.05)
    alone, together = both(text, efforts)
    assert np.ptp(alone.position_rad[:, 0]) > 1e-3
    for i in range(3):
        assert np.abs(together.pose[:, i] - alone.pose_rad).max() < SERVO_AS_MOTOR
        assert np.abs(together.velocity[:, i] - alone.velocity_rad_s).max() < 100 * SERVO_AS_MOTOR
        assert np.abs(together.applied[:, i] - alone.applied).max() < ROUNDING
    assert together.failure == (None,) * 3


def test_what_acts_is_what_the_end_of_a_servos_range_leaves():
    text = hard(CUT, 1e-4)
    alone, together = both(text, np.tile([5.0, 0.9], (40, 1)))
    assert alone.commanded[0, 1] == 0.9
    assert alone.applied[0, 1] < 0.1
    assert np.ptp(alone.applied[:, 1]) > 1e-4, "the range moves with the servo"
    assert together.commanded[0, 0, 1] == 0.9
    # Ten simulator steps a period: a single run logs what acts in the first one, an ensemble the mean of all.
    assert together.applied[:, 0, 1].max() < 0.1
    assert np.abs(together.pose[:, 1] - alone.pose_rad).max() < SERVO_AS_MOTOR


@pytest.mark.parametrize("text", [GRIPPER, RSSR], ids=["servo", "ball"])
def test_a_machine_is_the_same_to_the_last_bit_whatever_runs_beside_it(text):
    machines = [
        Imperfections(
            start=Start(position_error=1e-3 * i),
            machine=Machine(mass_factor=1 + 0.1 * i, viscous=1e-3),
            drives=Drives(constant_factor=1.0 + 0.01 * i),
        )
        for i in range(5)
    ]
    mechanism = load_mechanism(text)
    efforts = wave(mechanism, 0.05)
    _, many = both(text, efforts, machines)
    assert len(set(many.pose[-1, :, 0])) == 5
    for i in (1, 4):
        _, one = both(text, efforts, machines[i : i + 1])
        assert np.array_equal(one.pose[:, 0], many.pose[:, i])
        assert np.array_equal(one.applied[:, 0], many.applied[:, i])


def test_a_start_beside_the_path_closes_the_loop_of_a_ball_joint():
    _, ensemble = both(RSSR, np.zeros((3, 1)), [Imperfections(start=Start(position_error=np.array([0.02, 0.0])))])
    mechanism = load_mechanism(RSSR)
    assert mechanism.gap_m(ensemble.pose[0, 0]) < 1e-9
    assert ensemble.pose[0, 0, mechanism.independent[0]] == pytest.approx(mechanism.home[mechanism.independent[0]] + 0.02)


@pytest.mark.parametrize("off", [1.6, -2.5])
def test_a_start_far_beside_the_path_is_on_the_path_s_branch(off):
    """A crank that nothing stops: Newton's method from the plan's own start would not close the loop there."""
    mechanism = load_mechanism("slider-crank")
    _, ensemble = both("slider-crank", np.zeros((2, 1)), [Imperfections(start=Start(position_error=off))])
    assert ensemble.failure == (None,)
    there = close_at(mechanism, mechanism.home[mechanism.independent] + off)
    assert ensemble.pose[0, 0] == pytest.approx(there, abs=1e-9)


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
def test_a_servo_whose_gain_changes_gives_what_the_end_of_its_range_leaves(integrator):
    servo = '<general name="grip" tendon="split" gaintype="affine" gainprm="5 1 0" biastype="affine" biasprm="0 -5 0"'
    old = '<position name="grip" tendon="split" kp="5" kv="0.05" forcerange="-1 1" ctrlrange="-0.6 0.6"/>'
    text = replaced(GRIPPER, old, f'{servo} forcerange="-1 1" ctrlrange="-0.01 0.01"/>')
    mechanism = load_mechanism(hard(text, PERIOD_S, integrator))
    alone, _ = both(hard(text, PERIOD_S, integrator), np.tile([5.0, 0.9], (40, 1)))
    data = mujoco.MjData(mechanism.model)
    for pose, applied in zip(alone.pose_rad, alone.applied[:, 1], strict=True):
        data.qpos[:] = pose
        mujoco.mj_forward(mechanism.model, data)
        length = data.actuator_length[mechanism.actuators[1].output]
        assert applied == pytest.approx((5 + length) * 0.01 - 5 * length, abs=ROUNDING)
    assert np.ptp(alone.applied[:, 1]) > 1e-3, "the range moves with the servo"
