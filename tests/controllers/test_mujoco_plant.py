"""MuJoCo as a plant: logged efforts, delays, mass factors, the memory of a log, and the largest gaps and contacts."""

import copy
import time
from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from mujoco.batch import Batch

from linkplan.controllers.feedback_loop import LoopLog
from linkplan.controllers.imperfections.batch_effects import ClosureWatch
from linkplan.controllers.imperfections.imperfections import Clock, Drives, Imperfections, Machine
from linkplan.controllers.imperfections.plant import change_numbers
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.simulate import Ensemble, bytes_each
from linkplan.controllers.trackers.pd import pd
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.payload import BODY_NAME
from tests.support.bodies import HINGE, HINGE_INERTIA
from tests.support.machines import reach, run_machines
from tests.support.mechanisms import replaced
from tests.support.plans import optimal
from tests.support.references import hinge_reference
from tests.support.scripted import Scripted

# Efforts of (k + 1) / 4 at instant k.
RAMP = Scripted(efforts=0.25 * np.arange(1.0, 9.0)[:, None])


def ramped(one: Imperfections) -> Ensemble:
    """Return the run of a ramp over 8 periods of 10 ms, in steps of 2 ms."""
    mechanism = load_mechanism(HINGE)
    loop = ControlLoop(effort_limit=mechanism.effort_limit)
    return run_machines(mechanism, hinge_reference(mechanism, 8), RAMP, loop, [one])


@pytest.mark.parametrize(
    "one",
    [
        Imperfections(clock=Clock(delay_periods=0.4)),
        Imperfections(clock=Clock(delay_periods=1.3)),
        Imperfections(drives=Drives(bandwidth_hz=30.0)),
        Imperfections(drives=Drives(rate_limit=20.0)),
    ],
    ids=["whole steps", "part of a step", "lag", "rate"],
)
def test_the_logged_effort_of_a_period_is_the_mean_that_moves_the_inertia(one):
    found = ramped(one)
    gained = 0.01 * found.applied[:-1, 0, 0] / HINGE_INERTIA
    assert np.diff(found.velocity[:, 0, 0]) == pytest.approx(gained, rel=1e-9)
    assert np.ptp(np.diff(found.applied[1:, 0, 0])) < 0.3  # it goes on rising


def test_a_delay_of_two_of_five_steps_mixes_both_commands_in_that_proportion():
    applied = ramped(Imperfections(clock=Clock(delay_periods=0.4))).applied[:, 0, 0]
    asked = 0.25 * np.arange(1, 9)
    assert applied == pytest.approx(0.4 * np.append(asked[:1], asked[:-1]) + 0.6 * asked, rel=1e-12)


def test_the_memory_of_a_machine_s_log_is_that_of_its_arrays():
    mechanism, _ = reach()
    log = LoopLog(7, 1, mechanism.n_q, mechanism.dof, mechanism.n_u)
    time_and_power = 2 * 7 * 8
    assert bytes_each(mechanism, 7) == log.instants.nbytes + log.applied.nbytes + log.speed.nbytes + time_and_power


def test_the_tracker_s_computing_time_is_a_part_of_the_run_s():
    mechanism = load_mechanism(HINGE)
    reference = hinge_reference(mechanism, 20)
    begin = time.perf_counter()
    found = run_machines(
        mechanism,
        reference,
        pd(mechanism, reference, 1.0, 1.0),
        ControlLoop(effort_limit=mechanism.effort_limit),
        [Imperfections()],
    )
    assert np.all(found.asked_s > 0)
    assert found.asked_s.sum() < time.perf_counter() - begin


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
def test_a_damped_servo_gives_the_effort_asked_whatever_speed_the_integrator_takes(integrator):
    """In an implicit step, the damping kv acts on the speed at the end of the step, which a constant acceleration gives.

    The effort I a of the reference then moves the hinge by it to rounding, in steps of 2 ms, five in a period.
    """
    servo = '<position name="motor" joint="J" kp="20" kv="3"/></actuator>'
    text = replaced(HINGE, '<motor name="motor" joint="J" ctrlrange="-4 4"/></actuator>', servo)
    mechanism = load_mechanism(
        replaced(text, '<option gravity="0 0 0"/>', f'<option gravity="0 0 0" integrator="{integrator}"/>')
    )
    n, acceleration = 10, 2.0
    still = hinge_reference(mechanism, n)
    speed = acceleration * still.time_s[:, None]
    reference = replace(still, velocity_rad_s=speed, position_rad=0.5 * speed * still.time_s[:, None])
    law = Scripted(efforts=np.full((n, 1), HINGE_INERTIA * acceleration))
    loop = ControlLoop(effort_limit=np.array([[-4.0, 4.0]]))
    found = run_machines(mechanism, reference, law, loop, [Imperfections()])
    assert found.velocity[:, 0] == pytest.approx(speed, rel=1e-9, abs=1e-12)


# Masses.


def by_body(values: Callable[[mujoco.MjModel], np.ndarray], before: mujoco.MjModel, after: mujoco.MjModel) -> dict:
    with np.errstate(invalid="ignore"):
        return {after.body(i).name: values(after)[i] / values(before)[i] for i in range(1, after.nbody)}


def scaled_model(mechanism: Mechanism, factor: float) -> mujoco.MjModel:
    model = copy.deepcopy(mechanism.model)
    change_numbers(model, Machine(), factor)
    return model


@pytest.mark.parametrize("factor", [0.5, 1.3])
def test_a_mass_factor_scales_the_payload_and_nothing_else(factor):
    mechanism = optimal("knee-reach").problem.mechanism
    scaled = scaled_model(mechanism, factor)
    masses = by_body(lambda model: model.body_mass, mechanism.model, scaled)
    inertias = by_body(lambda model: model.body_inertia[:, 1], mechanism.model, scaled)
    assert masses[BODY_NAME] == pytest.approx(factor)
    assert inertias[BODY_NAME] == pytest.approx(factor)
    for body in ("crank", "coupler", "rocker"):
        assert masses[body] == inertias[body] == 1.0
    np.testing.assert_array_equal(scaled.body_ipos, mechanism.model.body_ipos)


def test_without_a_payload_a_mass_factor_scales_every_moving_body():
    mechanism = optimal("knee-sine").problem.mechanism
    scaled = scaled_model(mechanism, 1.3)
    masses = by_body(lambda model: model.body_mass, mechanism.model, scaled)
    assert [masses[body] for body in ("crank", "coupler", "rocker")] == pytest.approx([1.3] * 3)
    assert scaled.body_mass[1] == mechanism.model.body_mass[1]  # the thigh does not move


FOURBAR = """
<mujoco model="tied">
  <default><geom type="capsule" size="0.01" contype="0" conaffinity="0"/><joint axis="0 1 0"/></default>
  <worldbody>
    <body name="crank"><joint name="O"/><geom fromto="0 0 0 0 0 0.1"/>
      <body name="coupler" pos="0 0 0.1"><joint name="A"/><geom fromto="0 0 0 0.3 0 0"/></body></body>
    <body name="rocker" pos="0.3 0 0"><joint name="C"/><geom fromto="0 0 0 0 0 0.1"/></body>
  </worldbody>
  <equality>{tie}</equality>
  <actuator>{drive}</actuator>
</mujoco>"""
MOTOR = '<motor name="m" joint="O" ctrlrange="-5 5"/>'
TIES = {
    "bodies": '<connect body1="coupler" body2="rocker" anchor="0.3 0 0"/>',
    "the other way": '<connect body1="rocker" body2="coupler" anchor="0 0 0.1"/>',
}


@pytest.mark.parametrize("name", [*TIES, "sites of the knee"])
def test_the_gap_of_bodies_and_of_sites_is_the_mechanism_s(name):
    mechanism = load_mechanism(FOURBAR.format(tie=TIES[name], drive=MOTOR)) if name in TIES else reach()[0]
    pose = mechanism.home + np.array([0.01, -0.004, 0.02])
    batch = Batch(mechanism.model, nsim=2)
    batch.bind("qpos")[:] = pose
    watch = ClosureWatch(batch, [mechanism.model] * 2)
    batch.forward()
    watch.note()
    assert mechanism.gap_m(pose) > 1e-4
    assert watch.largest()[0] == pytest.approx(mechanism.gap_m(pose))


def test_the_largest_gap_of_all_steps_is_kept_however_many_there_are():
    mechanism, _ = reach()
    off = np.array([0.01, -0.004, 0.02])
    batch = Batch(mechanism.model, nsim=1)
    watch = ClosureWatch(batch, [mechanism.model])
    for k in range(200):
        batch.bind("qpos")[:] = mechanism.home + (off if k == 70 else 0.1 * off)
        batch.forward()
        watch.note()
    assert watch.largest()[0] == pytest.approx(mechanism.gap_m(mechanism.home + off))


# A ball on a slide that touches the ground up to a height of its radius.
FALLING = """<mujoco><worldbody><geom type="plane" size="1 1 1"/>
<body pos="0 0 1"><joint name="J" type="slide" axis="0 0 1"/><geom size="0.1" mass="1"/></body></worldbody></mujoco>"""


def test_the_largest_number_of_contacts_of_each_simulation_is_kept():
    model = mujoco.MjModel.from_xml_string(FALLING)
    batch = Batch(model, nsim=2)
    watch = ClosureWatch(batch, [model] * 2)
    for heights in ([-0.5, -0.5], [-0.95, -0.5], [-0.5, -0.5]):
        batch.bind("qpos")[:, 0] = heights
        batch.forward()
        watch.note()
    assert watch.largest()[1].tolist() == [1, 0]
    batch.bind("qpos")[:, 0] = [-0.5, -0.95]
    batch.forward()
    watch.note()
    assert watch.largest()[1].tolist() == [1, 1]


def test_copies_of_many_machines_take_at_most_eight_mebibytes():
    model, n = load_mechanism("optimus-knee").model, 600
    batch = Batch(model, nsim=n)
    batch.forward()
    watch = ClosureWatch(batch, [model] * n)
    copied = sum(array.nbytes for array in watch._copies.values())
    assert 4 * 2**20 < copied <= 8 * 2**20
    for _ in range(100):
        watch.note()
    assert np.ptp(watch.largest()[0]) == 0.0
