"""Serial equivalents: inertia, mass and losses at home are kept, and the error that is stated is measured in MuJoCo."""

import copy
import functools

import mujoco
import numpy as np
import pytest

from linkplan.models.errors import ModelError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import follow
from linkplan.models.transfer.grid import Grid
from linkplan.models.transfer.output_map import OutputMap, output_map, transmission
from linkplan.models.transfer.rest import OutputMotion, SerialErrors, rest_effort, rest_values, serial_errors
from linkplan.models.transfer.serial import SerialModel, serial_model
from linkplan.models.transfer.table import transfer_table
from tests.support import parallel_ankle
from tests.support.mechanisms import replaced

OUTPUTS = ["ankle_pitch", "ankle_roll"]
# The tree's text has six digits.
TEXT_DIGITS = 2e-5
# Of the closed chain in MuJoCo: its loops gape by the square of it.
STEP_S = 2e-5


def frictionless() -> str:
    """Return the ankle without dry friction, which MuJoCo makes soft."""
    return parallel_ankle.ankle_text().replace(f'frictionloss="{parallel_ankle.FRICTION}"', "")


@functools.cache
def ankle() -> tuple[OutputMap, SerialModel]:
    outputs = output_map(load_mechanism(frictionless(), independent=OUTPUTS), OUTPUTS)
    return outputs, serial_model(outputs, outputs.effort_limit)


@functools.cache
def rest() -> tuple[Grid, dict[str, np.ndarray]]:
    outputs, serial = ankle()
    grid = transfer_table(outputs, 5e-3).grid
    return grid, rest_values(outputs, serial, grid)


def fast_motion(n: int = 2000) -> OutputMotion:
    """Return a motion of pitch and roll at 3 and 4 Hz over most of their ranges."""
    t = np.linspace(0, 0.5, n)
    amplitude, w = np.array([0.45, 0.25]), 2 * np.pi * np.array([3.0, 4.0])
    phase = w * t[:, None]
    return OutputMotion(
        time_s=t,
        position=[-0.1, 0.0] + amplitude * (1 - np.cos(phase)) / 2 * [1, 1] - [0.15, 0.1],
        velocity=amplitude * w * np.sin(phase) / 2,
        acceleration=amplitude * w**2 * np.cos(phase) / 2,
    )


@functools.cache
def stated() -> SerialErrors:
    return serial_errors(*ankle(), rest()[1], rest()[0], fast_motion())


def test_the_tree_has_no_loops_the_same_mass_and_the_same_inertia_of_each_joint_at_home():
    outputs, serial = ankle()
    tree, model = serial.mechanism.model, outputs.mechanism.model
    assert (tree.neq, tree.nv, serial.mechanism.dof) == (0, 2, 2)
    assert tree.body_mass.sum() == pytest.approx(model.body_mass.sum(), rel=TEXT_DIGITS)
    closed = transmission(outputs, outputs.mechanism.home[None])
    found = transmission(serial.outputs, serial.mechanism.home[None])
    for name in ("inertia", "damping"):
        both = [np.diagonal(getattr(one, name)[0]) for one in (found, closed)]
        np.testing.assert_allclose(*both, rtol=TEXT_DIGITS)
    assert min(serial.armature) > 0.01  # most of it is the linkage's


def test_dry_friction_is_carried_too():
    outputs = output_map(load_mechanism(parallel_ankle.ankle_text(), independent=OUTPUTS), OUTPUTS)
    serial = serial_model(outputs, outputs.effort_limit)
    wanted = transmission(outputs, outputs.mechanism.home[None]).friction[0]
    np.testing.assert_allclose(serial.mechanism.model.dof_frictionloss, wanted, rtol=TEXT_DIGITS)


def test_the_tree_s_motors_have_the_bounding_box_of_efforts_at_home():
    outputs, serial = ankle()
    G = transmission(outputs, outputs.mechanism.home[None]).ratio[0]
    limit = 40.0 * np.abs(G).sum(axis=0)
    np.testing.assert_allclose(serial.mechanism.effort_limit, np.column_stack([-limit, limit]), rtol=TEXT_DIGITS)


def test_bodies_of_the_linkage_stay_at_home_and_touch_nothing():
    text = replaced(frictionless(), 'contype="0" conaffinity="0"', "")
    outputs = output_map(load_mechanism(text, independent=OUTPUTS), OUTPUTS)
    tree = serial_model(outputs, outputs.effort_limit).mechanism.model
    data, closed = mujoco.MjData(tree), mujoco.MjData(outputs.mechanism.model)
    closed.qpos[:] = outputs.mechanism.qpos_of(outputs.mechanism.home)
    for model, one in ((tree, data), (outputs.mechanism.model, closed)):
        mujoco.mj_kinematics(model, one)
    for name in ("crank_left", "rod_right"):
        np.testing.assert_allclose(data.body(name).xpos, closed.body(name).xpos, atol=1e-5)
    moving = [g for g in range(tree.ngeom) if tree.body(tree.geom_bodyid[g]).name.startswith("rod")]
    assert len(moving) == 2
    assert not tree.geom_contype[moving].any()
    assert tree.geom_contype.any()


def test_the_rms_of_an_error_is_over_time_and_not_over_samples():
    """Of an error t over 0 to 1 s, it is 1 / sqrt(3), however the samples crowd at its end."""
    time = np.concatenate([np.linspace(0.0, 0.9, 901), np.linspace(0.9, 1.0, 5000)[1:]])
    zero = np.zeros((len(time), 1))
    motion = OutputMotion(time_s=time, position=zero, velocity=zero, acceleration=zero)
    errors = SerialErrors(motion=motion, effort=zero, static_map=time[:, None], serial=zero, with_table=zero)
    assert errors.rms()["static map"] == pytest.approx([1.0 / np.sqrt(3.0)], rel=1e-6)


def test_with_its_table_the_tree_needs_the_closed_chain_s_effort():
    errors = stated()
    peak = np.abs(errors.effort).max(axis=0)
    left = np.abs(errors.with_table).max(axis=0)
    assert np.all(np.abs(errors.static_map).max(axis=0) > 0.5 * peak)  # most of the effort is reflected
    assert np.all(np.abs(errors.serial).max(axis=0) > 0.1 * peak)
    assert np.all(left < 0.01 * peak)
    assert np.all(left > 0)


@functools.cache
def measured() -> tuple[OutputMotion, np.ndarray]:
    """Return a motion of MuJoCo's closed chain, and its joint effort G^T u less the tree's inverse dynamics along it."""
    outputs, serial = ankle()
    motion, mechanism, tree = fast_motion(), outputs.mechanism, serial.mechanism.model
    q = follow(mechanism, outputs.independent(motion.position))
    ratios = transmission(outputs, q).ratio
    feedforward = np.linalg.solve(ratios.transpose(0, 2, 1), stated().effort[:, :, None])[:, :, 0]
    model = copy.copy(mechanism.model)
    model.opt.timestep, model.eq_solref[:, 0] = STEP_S, 2 * STEP_S  # stiff loops
    data, other = mujoco.MjData(model), mujoco.MjData(tree)
    data.qpos[:] = mechanism.qpos_of(q[0])
    outs, of_tree = ([one.joint(name).id for name in OUTPUTS] for one in (model, tree))
    rows = []
    for k in range(int(motion.time_s[-1] / STEP_S)):
        near = min(int(k * STEP_S / motion.time_s[1]), len(q) - 1)
        off = motion.position[near] - data.qpos[outs], motion.velocity[near] - data.qvel[outs]
        data.ctrl[:] = feedforward[near] + np.linalg.solve(ratios[near].T, 400 * off[0] + 4 * off[1])
        mujoco.mj_step(model, data)
        if k % 100 == 99 and k > 1000:
            mujoco.mj_forward(model, data)
            state = [x[outs].copy() for x in (data.qpos, data.qvel, data.qacc)]
            other.qpos[of_tree], other.qvel[of_tree], other.qacc[of_tree] = state
            mujoco.mj_inverse(tree, other)
            ratio = transmission(outputs, mechanism.q_of(data.qpos[None])).ratio[0]
            rows.append([data.time, *state, ratio.T @ data.actuator_force - other.qfrc_inverse[of_tree]])
        assert np.abs(off[0]).max() < 0.01  # it follows
    made = OutputMotion(
        **{key: np.array([row[k] for row in rows]) for k, key in enumerate(OutputMotion.__dataclass_fields__)}
    )
    return made, np.array([row[-1] for row in rows])


def sizes(errors: np.ndarray) -> list[float]:
    """Return the root mean square and the largest error of each joint."""
    return [*np.sqrt(np.mean(errors**2, axis=0)), *np.abs(errors).max(axis=0)]


@pytest.mark.slow
def test_the_stated_error_of_the_tree_is_the_error_measured_in_mujoco():
    _, errors = measured()
    assert np.abs(errors).max() > 0.3  # [N.m], of an effort of 5
    assert sizes(errors) == pytest.approx(sizes(stated().serial), rel=0.1)


@pytest.mark.slow
def test_the_stated_error_of_the_tree_with_its_table_is_the_error_measured_in_mujoco():
    outputs, serial = ankle()
    grid = transfer_table(outputs, 0.1).grid  # coarse, so that its error is larger than that of MuJoCo's soft loops
    values = rest_values(outputs, serial, grid)
    made, errors = measured()
    left = errors - rest_effort(outputs, serial, values, grid, made)
    wanted = serial_errors(outputs, serial, values, grid, made).with_table
    assert np.abs(left).max() < 0.1 * np.abs(errors).max()
    assert sizes(left) == pytest.approx(sizes(wanted), rel=0.1)


def test_an_output_that_moves_on_the_linkage_has_no_serial_equivalent():
    outputs = output_map(load_mechanism("five-bar", independent=["O1", "P"]), ["O1", "P"])
    with pytest.raises(ModelError, match="joint P moves on a part of the linkage"):
        serial_model(outputs, outputs.effort_limit)


# A motor of the knee on the hip's axis, with a belt that passes the hip.
BELT = """<mujoco model="belt"><default><geom contype="0" conaffinity="0" type="capsule" size=".015"/>
<joint axis="0 -1 0"/></default><worldbody><body name="base" pos="0 0 1">
<body name="pulley"><joint name="km" armature=".02"/>
<inertial pos="0 0 0" mass=".05" diaginertia="1e-5 1e-5 1e-5"/></body>
<body name="thigh"><joint name="hip" armature=".03"/><geom fromto="0 0 0 0 0 -.3" mass="1.1"/>
<body name="shank" pos="0 0 -.3"><joint name="knee" range="-140 10"/><geom fromto="0 0 0 0 0 -.28" mass=".5"/>
</body></body></body>
</worldbody><equality><tendon tendon1="run"/></equality>
<tendon><fixed name="run"><joint joint="km" coef=".03"/><joint joint="hip" coef="-.045"/>
<joint joint="knee" coef="-.045"/></fixed>
<fixed><joint joint="knee" coef=".1"/></fixed></tendon>
<actuator><motor name="mh" joint="hip" ctrlrange="-25 25"/>
<motor name="mk" joint="km" ctrlrange="-25 25"/></actuator></mujoco>"""


def test_a_belt_over_a_removed_joint_leaves_its_ratio_in_the_serial_equivalent():
    outputs = output_map(load_mechanism(BELT, independent=["hip", "knee"]), ["hip", "knee"])
    serial = serial_model(outputs, outputs.effort_limit)
    assert serial.removed == ("km",)
    np.testing.assert_allclose(serial.armature, 1.5**2 * (0.02 + 1e-5), rtol=1e-9)
    np.testing.assert_allclose(serial.effort_limit[:, 1], [25.0 + 1.5 * 25.0, 1.5 * 25.0], rtol=1e-9)
    model = mujoco.MjModel.from_xml_string(serial.text)
    assert (model.njnt, model.neq, model.ntendon) == (2, 0, 1)  # the tendon over the knee alone stays
