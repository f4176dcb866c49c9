"""Imperfections of the plant against what Newton's laws say of them, and that no tracker is told."""

import copy
from functools import cache

import mujoco
import numpy as np
import pytest

from linkplan.controllers.imperfections.imperfections import Clock, Imperfections, Machine, Push, Start
from linkplan.controllers.imperfections.plant import closed_pose, plant
from linkplan.controllers.reference import SampledReference, sample
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.simulate import Ensemble
from linkplan.controllers.trackers.names import TRACKERS
from linkplan.controllers.trackers.tracker import steps_of
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.studies.compare.compare import build_tracker
from tests.support.bodies import HINGE, HINGE_INERTIA
from tests.support.machines import LOOP, everything, reach, run_machines
from tests.support.motions import motion_along
from tests.support.plans import optimal
from tests.support.scripted import Scripted

PERIOD = 1e-3


@cache
def at_rest(mjcf: str, duration_s: float) -> tuple[Mechanism, SampledReference]:
    mechanism = load_mechanism(mjcf)
    still = motion_along([0.0, 1.0], np.zeros((2, 1, 1)))
    return mechanism, sample(mechanism, still, PERIOD, duration_s)


def turned(effort: float = 0.0, mjcf: str = HINGE, **imperfect) -> Ensemble:
    """Return the run of a body at rest on a hinge, over a tenth of a second, under an effort that is asked for."""
    mechanism, reference = at_rest(mjcf, 0.1 + PERIOD)
    law, loop = Scripted(efforts=np.full((reference.n, 1), effort)), ControlLoop(effort_limit=mechanism.effort_limit)
    found = run_machines(mechanism, reference, law, loop, [Imperfections(**imperfect)])
    assert found.failure == (None,)
    return found


# Of a pure inertia I: what an effort's impulse makes of its speed.


def test_a_push_is_at_its_time_whatever_the_phase_of_the_clock():
    """Instant k of a clock half a period late is at (k + 0.5) T: only the time until the push's end is shorter."""
    push = Push(start_s=0.0203, duration_s=0.0134, joint="J", effort=3.0)
    found = turned(clock=Clock(phase_periods=0.5), pushes=(push,))
    acting = np.clip(found.time_s[:, 0] - 0.0203, 0.0, 0.0134)
    assert found.time_s[0, 0] == pytest.approx(0.5 * PERIOD)
    assert found.velocity[:, 0, 0] == pytest.approx(3.0 * acting / HINGE_INERTIA, abs=1e-9)


def test_an_effort_acts_through_an_actuator_with_a_gain_and_a_constant_force():
    """The model's effort at a ctrl is 2 ctrl + 0.5: an effort of 1.5 is one of 1.5."""
    servo = '<general name="m" joint="J" gainprm="2" biastype="affine" biasprm="0.5" ctrlrange="-9 9" ctrllimited="true"/>'
    found = turned(1.5, HINGE[: HINGE.index("<actuator>")] + f"<actuator>{servo}</actuator></mujoco>")
    assert found.velocity[-1, 0, 0] == pytest.approx(1.5 * 0.1 / HINGE_INERTIA, rel=1e-9)


def test_coulomb_friction_stops_what_moves_and_holds_what_pushes_less():
    assert abs(turned(machine=Machine(coulomb=0.9), start=Start(velocity_error=0.2)).velocity[-1, 0, 0]) < 1e-6
    held = turned(0.8, machine=Machine(coulomb=0.9))
    assert abs(held.pose[-1, 0, 0]) < 1e-5
    assert turned(1.2, machine=Machine(coulomb=0.9)).velocity[-1, 0, 0] == pytest.approx(0.3 * 0.1 / HINGE_INERTIA, rel=0.01)


# Of the knee: one kinematic loop, driven at O.


def acceleration(machine: Machine, speed: float, effort: float = 0.0) -> tuple[float, np.ndarray, float]:
    """Return the acceleration of O [rad/s2] in MuJoCo at a speed [rad/s], Gamma there, and the reduced inertia [kg m2]."""
    mechanism, reference = reach()
    imperfect = Imperfections(machine=machine, start=Start(velocity_error=speed - reference.velocity_rad_s[0]))
    built = plant(mechanism, reference, LOOP, imperfect, 1)
    data = mujoco.MjData(built.model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = built.pose, built.rates, effort
    mujoco.mj_forward(built.model, data)
    gamma = np.array(mechanism.dynamics.velocity_map(built.pose)).ravel()
    return float(data.qacc[0]), gamma, float(mechanism.dynamics.reduced_inertia(built.pose))


@pytest.mark.parametrize("joint", [1, 2])
@pytest.mark.parametrize("speed", [0.3, -3.0])
def test_friction_at_a_passive_joint_of_the_loop_acts_by_its_share_of_the_motion(joint, speed):
    """M_r a = ... - Gamma_j (d Gamma_j v + c sign(Gamma_j v)); the loop's constraint gives way by a thousandth."""
    d, c = 0.05, 0.4
    at = np.eye(3)[joint]
    free, gamma, inertia = acceleration(Machine(), speed)
    viscous = acceleration(Machine(viscous=d * at), speed)[0] - free
    dry = acceleration(Machine(coulomb=c * at), speed)[0] - free
    share = gamma[joint]
    assert abs(share) > 0.1
    assert viscous == pytest.approx(-share * d * share * speed / inertia, rel=0.01)
    assert dry == pytest.approx(-share * c * np.sign(share * speed) / inertia, rel=0.01)


def test_a_loop_s_stiffness_is_that_of_its_time_constant_and_damping_ratio():
    """Open by r, MuJoCo's constraint asks for -r / (d tc^2 zeta^2), d its impedance (documentation, Solver parameters)."""
    mechanism, reference = reach()
    tc, zeta = 5e-4, 0.7
    model = plant(mechanism, reference, LOOP, Imperfections(machine=Machine(loop_solref=(tc, zeta))), 1).model
    data = mujoco.MjData(model)
    data.qpos[:] = mechanism.home + np.array([0.0, 1e-3, 0.0])
    mujoco.mj_forward(model, data)
    rows = (data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)) & (np.abs(data.efc_pos) > 1e-6)
    assert np.any(rows)
    assert data.efc_aref[rows] == pytest.approx(-data.efc_pos[rows] / (0.999 * (tc * zeta) ** 2), rel=1e-6)


# Trackers.


def saved(model: mujoco.MjModel) -> bytes:
    buffer = np.zeros(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


@pytest.mark.parametrize("kind", TRACKERS)
def test_no_imperfection_of_the_machine_is_told_to_the_tracker(kind):
    """Its commands are its law's, built from the plan alone, at the states that it measures; its model stays as it was."""
    mechanism, reference = reach()
    plan = optimal("knee-reach")
    machine = everything(1)
    wrong = Imperfections(
        clock=machine.clock, drives=machine.drives, machine=machine.machine, start=machine.start, pushes=machine.pushes
    )
    before = mechanism.fingerprint(), saved(mechanism.model)
    found = run_machines(mechanism, reference, build_tracker(kind, plan, reference), LOOP, [wrong])
    assert (mechanism.fingerprint(), saved(mechanism.model)) == before
    assert np.abs(found.pose[:, 0] - reference.pose_rad).max() > 1e-4  # it is another machine
    law = steps_of(build_tracker(kind, plan, reference))
    memory = law.start(1)
    for k in range(reference.n):
        effort, memory = law.step(k, found.pose[k][:, mechanism.independent], found.velocity[k], memory)
        np.testing.assert_array_equal(effort, found.commanded[k])


def test_a_gap_along_the_hinges_of_a_planar_loop_stays_and_takes_no_part_in_its_motion():
    """A site of the closure is moved out of the plane, along the hinges, which no joint changes."""
    mechanism = load_mechanism("optimus-knee")
    model = copy.deepcopy(mechanism.model)
    model.site_pos[model.eq_obj1id[0], 1] += 3e-5
    data = mujoco.MjData(model)
    assert closed_pose(model, data, mechanism, mechanism.home) == pytest.approx(mechanism.home, abs=1e-6)
    assert np.sort(np.abs(data.efc_pos[: data.ne])) == pytest.approx([0.0, 0.0, 3e-5], abs=1e-11)
    # The coupler of 213.3 mm is longer than the rocker of 85.5 mm and the distance of their pins, 80.6 mm, together.
    model.site_pos[model.eq_obj1id[0], 0] += 0.2
    with pytest.raises(AssemblyError, match=r"does not close at the start, O = 0 deg, .* a gap of 4[67]\.\d mm remains"):
        closed_pose(model, data, mechanism, mechanism.home)
