"""Many machines at once: each as if it ran alone, on trees and on linkages with servos and ball joints."""

import copy
import dataclasses
from dataclasses import dataclass

import mujoco
import numpy as np
import pytest

from linkplan.controllers.feedback_loop import states_of
from linkplan.controllers.imperfections.imperfections import Drives, Imperfections, Machine, Push, Start
from linkplan.controllers.mujoco_plant import DIVERGED, MujocoPlant
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.simulate import Ensemble, simulate
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import close_at
from tests.support.linkages import GRIPPER, RSSR
from tests.support.machines import LOOP, everything, feedback, follower, reach, run_alone, run_machines
from tests.support.mechanisms import replaced
from tests.support.scripted import PERIOD_S, Scripted, hard, standing, wave
from tests.support.tolerances_planner import ROUNDING, SERVO_AS_MOTOR


def logs(ensemble: Ensemble, i: int) -> list[np.ndarray]:
    names = ("time_s", "pose", "velocity", "commanded", "applied", "power")
    return [getattr(ensemble, name)[:, i] for name in names] + [ensemble.gap_m[i : i + 1]]


def same_bits(first: list[np.ndarray], second: list[np.ndarray]) -> bool:
    return all(np.array_equal(a, b, equal_nan=True) for a, b in zip(first, second, strict=True))


def test_a_machine_that_diverges_is_frozen_and_harms_no_other(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mechanism, reference = reach()
    blown = Imperfections(pushes=(Push(start_s=0.005, duration_s=0.001, joint="O", effort=1e16),))
    good = [everything(1), everything(2)]
    alone = run_machines(mechanism, reference, follower(), LOOP, good)
    beside = run_machines(mechanism, reference, follower(), LOOP, [good[0], blown, good[1]])
    assert beside.failure == (None, DIVERGED, None)
    assert same_bits(logs(beside, 0), logs(alone, 0))
    assert same_bits(logs(beside, 2), logs(alone, 1))
    assert 50 <= beside.done[1] < 60
    assert np.all(np.isfinite(beside.pose[: beside.done[1], 1]))
    assert np.all(np.isnan(beside.pose[beside.done[1] :, 1]))
    assert not list(tmp_path.iterdir())  # MuJoCo writes warnings into a log file where nobody takes them


@dataclass(frozen=True)
class _Single:
    """A law of single states, which fails for some."""

    name: str = "single"

    def effort(self, k, position, velocity):
        assert position.shape == (1,)
        if k > 20 and velocity[0] < -1.0:
            raise ValueError("this state is\nnot for me")
        return follower().effort(k, position, velocity)


def test_a_tracker_of_single_states_is_asked_for_each():
    mechanism, reference = reach()
    machines = [everything(seed) for seed in range(3)]
    one_by_one = run_machines(mechanism, reference, _Single(), LOOP, machines)
    at_once = run_machines(mechanism, reference, follower(), LOOP, machines)
    for i in range(3):
        assert same_bits(logs(one_by_one, i), logs(at_once, i))


def test_a_tracker_that_raises_for_one_machine_is_told_of_in_one_line_and_the_others_go_on():
    mechanism, reference = reach()
    backwards = Imperfections(start=Start(velocity_error=-3.0))
    found = run_machines(mechanism, reference, _Single(), LOOP, [Imperfections(), backwards])
    assert found.failure[0] is None
    assert "this state is not for me" in found.failure[1]
    assert found.done.tolist() == [reference.n, 21]
    alone = run_machines(mechanism, reference, _Single(), LOOP, [Imperfections()])
    assert same_bits(logs(found, 0), logs(alone, 0))


@dataclass(frozen=True)
class _Counting:
    """A law whose memory counts the instants of each simulation."""

    name: str = "counting"

    def start(self, n):
        return np.zeros((n, 1))

    def step(self, k, position, velocity, memory):
        assert position.shape == velocity.shape == (len(memory), 1)
        assert np.all(memory == k)
        return memory.copy(), memory + 1


def test_a_tracker_is_not_evaluated_for_frozen_machines_and_keeps_the_memory_of_the_others():
    mechanism, reference = reach()
    blown = Imperfections(pushes=(Push(start_s=0.005, duration_s=0.001, joint="O", effort=1e16),))
    asked, counting = [], _Counting()

    class Recording(_Counting):
        def step(self, k, position, velocity, memory):
            asked.append(len(position))
            return counting.step(k, position, velocity, memory)

    found = run_machines(mechanism, reference, Recording(), LOOP, [blown, Imperfections()])
    assert found.failure == (DIVERGED, None)
    assert asked == [2] * (int(found.done[0]) + 1) + [1] * (reference.n - int(found.done[0]) - 1)
    assert np.array_equal(found.commanded[:, 1, 0], np.arange(reference.n))


def test_trackers_that_run_one_after_another_share_the_machines():
    mechanism, reference = reach()
    plant = MujocoPlant(mechanism=mechanism, loop=LOOP)
    machines = [Imperfections(), everything(1), Imperfections(), everything(2)]
    simulate(plant, feedback(), reference, machines)
    first = dict(plant.built)
    simulate(plant, follower(), reference, machines)
    assert len(first) == 3, "nominal machines share one plant"
    assert all(plant.built[key] is one for key, one in first.items())
    simulate(plant, follower(), reference, machines[:2])
    assert len(plant.built) == 2, "the memory of machines that run no more is given back"


def test_a_machine_of_many_closes_its_loop_by_a_sparse_jacobian_as_by_a_dense_one():
    mechanism, reference = reach()
    found = []
    for kind in (mujoco.mjtJacobian.mjJAC_DENSE, mujoco.mjtJacobian.mjJAC_SPARSE):
        model = copy.deepcopy(mechanism.model)
        model.opt.jacobian = kind
        stepper, failure = MujocoPlant(mechanism=dataclasses.replace(mechanism, model=model), loop=LOOP).begin(
            reference, [everything(1)]
        )
        assert failure == [None]
        found.append(states_of(stepper))
    assert np.abs(found[0][0] - mechanism.home).max() > 1e-3
    for dense, sparse in zip(*found, strict=True):
        assert sparse == pytest.approx(dense, abs=1e-12)


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
