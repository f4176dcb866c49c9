"""Imperfections: each does to a machine what its unit and Newton's laws say, and no tracker is told."""

import copy
import operator
from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
from mujoco.batch import MODEL_FIELDS, Batch

from linkplan.controllers.imperfections.batch_effects import spread
from linkplan.controllers.imperfections.driving import act, driving, take
from linkplan.controllers.imperfections.imperfections import (
    Clock,
    Drives,
    Imperfections,
    Machine,
    Push,
    Sensors,
    Start,
    imperfections_from,
)
from linkplan.controllers.imperfections.plant import closed_pose, is_nominal, plant
from linkplan.controllers.imperfections.sensing import measure, sensing
from linkplan.controllers.reference import SampledReference, sample
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.simulate import Ensemble
from linkplan.controllers.trackers.names import TRACKERS
from linkplan.controllers.trackers.tracker import steps_of
from linkplan.models.errors import AssemblyError, LinkplanError
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.studies.compare.compare import build_tracker
from tests.support.bodies import HINGE, HINGE_INERTIA
from tests.support.machines import LOOP, everything, reach, run_machines
from tests.support.motions import motion_along
from tests.support.plans import optimal
from tests.support.references import hinge_reference
from tests.support.scripted import Scripted

LIMIT = np.array([[-10.0, 10.0]])
H = 1e-3


def acted(drives: Drives, commands: list[float], delay: float = 0.0, substeps: int = 1) -> np.ndarray:
    """Return the mean efforts of every simulator step under commands, one a period."""
    now = driving([drives], [delay], [H / substeps], substeps, LIMIT)
    efforts = []
    for k, command in enumerate(commands):
        take(now, k, np.array([[command]]))
        for j in range(substeps):
            efforts.append(act(now, k, j)[0, 0])
    return np.array(efforts)


# Drives.


@pytest.mark.parametrize(("delay", "substeps"), [(0.25, 1), (1.75, 1), (0.3, 5), (2.0, 1)])
def test_a_delay_of_any_fraction_moves_an_impulse_by_its_time(delay, substeps):
    commands = [0.0, 0.0, 6.0] + 6 * [0.0]
    efforts = acted(Drives(), commands, delay, substeps)
    middles = (np.arange(len(efforts)) + 0.5) / substeps
    assert efforts.sum() / substeps == pytest.approx(6.0)
    assert (middles * efforts).sum() / efforts.sum() == pytest.approx(2.5 + delay)


# Sensors.


def read(sensors: Sensors, positions: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    now = sensing([sensors], positions[:1, None], np.array([[rate]]), H)
    found = []
    for k, position in enumerate(positions):
        s, v = measure(now, k, np.array([[position]]), np.array([[rate]]))
        found.append((s[0, 0], v[0, 0]))
    return tuple(np.array(found).T)


def test_noise_has_its_standard_deviation_and_comes_from_its_own_seed():
    positions = np.zeros(4000)
    first, rate = read(Sensors(noise=0.02, velocity_noise=0.5, noise_seed=(1, 2)), positions, 0.0)
    other, _ = read(Sensors(noise=0.02, noise_seed=(1, 3)), positions, 0.0)
    assert np.std(first) == pytest.approx(0.02, rel=0.05)
    assert np.std(rate) == pytest.approx(0.5, rel=0.05)
    assert abs(np.corrcoef(first, other)[0, 1]) < 0.05
    assert abs(np.corrcoef(first[1:], first[:-1])[0, 1]) < 0.05


# The plant.


def test_every_field_in_which_a_machine_differs_is_that_of_its_own_model_in_a_batch():
    mechanism, reference = reach()
    before = copy.deepcopy(mechanism.model)
    base = plant(mechanism, reference, LOOP, Imperfections(), 1).model
    models = [base, *(plant(mechanism, reference, LOOP, everything(seed), 1).model for seed in range(3))]
    batch = Batch(base, len(models))
    spread(batch, base, models)
    values = {name: [np.array(operator.attrgetter(name)(model)) for model in models] for name in MODEL_FIELDS}
    changed = {name for name, (first, *others) in values.items() if any(np.any(other != first) for other in others)}
    assert {"body_mass", "dof_damping", "eq_solref", "site_pos", "opt.timestep"} <= changed
    for name in changed:
        np.testing.assert_array_equal(batch.expand(name), values[name], err_msg=name)
    assert np.array_equal(before.body_mass, mechanism.model.body_mass)
    assert np.array_equal(before.dof_damping, mechanism.model.dof_damping)


# A value of each type of field that differs from every neutral one.
ANOTHER = {
    "parameters": {"coupler.mass": 0.1},
    "com_shift_m": np.zeros(3),
    "length_factor": {"coupler": 1.01},
    "loop_solref": (0.02, 1.0),
}


@pytest.mark.parametrize(
    ("part", "name"),
    [(part, name) for part in ("machine", "drives", "start", "clock") for name in getattr(Imperfections(), part).__slots__],
)
def test_a_machine_with_any_other_value_is_not_nominal(part, name):
    neutral = getattr(Imperfections(), part)
    changed = replace(neutral, **{name: ANOTHER.get(name, np.array([0.5, 0.25]))})
    assert is_nominal(Imperfections())
    assert not is_nominal(replace(Imperfections(), **{part: changed}))


def test_numbers_by_name_make_the_machine_that_the_mechanism_with_them_is():
    mechanism, reference = reach()
    values = {"payload.mass": 4.4, "coupler.length": 0.0743, "A.friction": 0.02, "O.axis_y": 0.9, "crank.com_x": 0.01}
    machine = plant(mechanism, reference, LOOP, Imperfections(machine=Machine(parameters=values)), 1)
    other = mechanism.with_parameters(values)
    expected = plant(other, reference, LOOP, Imperfections(), 1).model
    for field in ("body_mass", "body_ipos", "eq_data", "site_pos", "dof_frictionloss", "jnt_axis", "dof_solref"):
        np.testing.assert_allclose(
            getattr(machine.model, field), getattr(expected, field), rtol=0, atol=1e-15, err_msg=field
        )
    shift = machine.pose - reference.pose_rad[0]
    assert np.abs(shift[mechanism.dependent]).max() > 1e-4
    assert np.abs(other.equations.closure(machine.pose)).max() < 1e-12


def test_a_machine_whose_arrays_are_neutral_is_nominal():
    mechanism, _ = reach()
    assert is_nominal(imperfections_from({}, mechanism, (0,)))


def test_a_longer_link_is_longer_and_the_loop_is_closed_with_it():
    mechanism, reference = reach()
    longer = Imperfections(machine=Machine(length_factor={"coupler": 1.01}), start=Start(velocity_error=1.0))
    built = plant(mechanism, reference, LOOP, longer, 1)
    data = mujoco.MjData(built.model)
    data.qpos[:], data.qvel[:] = built.pose, built.rates
    mujoco.mj_forward(built.model, data)
    B, A = data.site("B_coupler").xpos, data.body("coupler").xpos
    assert np.linalg.norm(B - A) == pytest.approx(1.01 * 0.0741)
    assert np.linalg.norm(B - data.site("B_rocker").xpos) < 1e-12
    assert built.pose[mechanism.independent] == reference.position_rad[0]
    assert np.abs(data.efc_vel[data.efc_type == 0]).max() < 1e-12
    assert abs(built.pose - reference.pose_rad[0]).max() > 1e-3


@pytest.mark.parametrize(
    ("machine", "said"),
    [
        ({"length_factor": {"coupler": 3.0}}, "does not close"),
        ({"length_factor": {"elbow": 1.01}}, "unknown body 'elbow'; legal: thigh, crank"),
        ({"loop_solref": (1e-4, 1.0)}, "at least 2 simulator steps"),
    ],
)
def test_a_machine_that_cannot_be_is_refused_in_one_line(machine, said):
    mechanism, reference = reach()
    with pytest.raises(LinkplanError, match=said):
        plant(mechanism, reference, LOOP, Imperfections(machine=Machine(**machine)), 1)


def test_a_loop_as_stiff_as_the_simulator_can_step_is_not_refused():
    mechanism, reference = reach()
    stiffest = 2 * reference.period_s
    built = plant(mechanism, reference, LOOP, Imperfections(machine=Machine(loop_solref=(stiffest, 1.0))), 1)
    assert np.all(built.model.eq_solref[:, 0] == stiffest)


# A joint off its body's origin; the effort at a ctrl is 2 ctrl + 0.5.
OFF_ORIGIN = """<mujoco><option gravity="0 0 0"/><worldbody><body name="arm" pos="0.1 0 0.2">
<joint name="J" axis="0 1 0" pos="0.3 0 0"/><inertial pos="-0.2 0 0.1" mass="1" diaginertia="0.1 0.1 0.1"/>
<site name="tip" pos="0.5 0 0.4"/></body></worldbody><actuator><general name="m" joint="J" gainprm="2" biastype="affine"
biasprm="0.5" ctrlrange="-10 10" ctrllimited="true"/></actuator></mujoco>"""


def off_origin(limit: float = 3.0, **machine) -> mujoco.MjModel:
    mechanism = load_mechanism(OFF_ORIGIN)
    loop = ControlLoop(effort_limit=np.array([[-limit, limit]]))
    return plant(mechanism, hinge_reference(mechanism), loop, Imperfections(machine=Machine(**machine)), 1).model


def test_a_link_grows_about_its_joint():
    distances = []
    for model in (off_origin(), off_origin(length_factor={"arm": 1.25})):
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        anchor = data.xanchor[0]
        assert anchor == pytest.approx([0.4, 0.0, 0.2])
        distances.append([data.site("tip").xpos - anchor, data.xipos[1] - anchor])
    assert np.array(distances[1]) == pytest.approx(1.25 * np.array(distances[0]))


PERIOD = 1e-3


@cache
def at_rest(mjcf: str, duration_s: float) -> tuple[Mechanism, SampledReference]:
    mechanism = load_mechanism(mjcf)
    still = motion_along([0.0, 1.0], np.zeros((2, 1, 1)))
    return mechanism, sample(mechanism, still, PERIOD, duration_s)


def turned(effort: float = 0.0, mjcf: str = HINGE, **imperfect) -> Ensemble:
    """Return the simulated run of a hinged body that starts at rest, for 0.1 s, when a constant effort is commanded."""
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
    """The model turns a ctrl into the effort 2 ctrl + 0.5; a commanded effort of 1.5 still gives 1.5."""
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
    """A site of the closure moves out of the plane, parallel to the hinge axes; no joint can close that gap."""
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
