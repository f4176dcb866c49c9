"""Quantities along poses: rates, efforts within limits, and the inertia that a drive feels."""

import copy

import mujoco
import numpy as np
import pytest

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses import along
from linkplan.models.poses.along import felt_inertia, joint_rates, sampled
from linkplan.models.poses.assembly import advance, follow, in_loops
from linkplan.models.poses.reach import reach, toggles
from tests.support.parallel_ankle import ankle_text, soft_ankle

# A parallelogram whose rocker carries an arm: no loop turns with the arm.
ARM_ON_A_LOOP = """<mujoco><default><geom type="capsule" size=".01"/><joint axis="0 1 0"/></default><worldbody>
  <body name="crank"><joint name="crank"/><geom fromto="0 0 0 0 0 .1"/>
    <body name="bar" pos="0 0 .1"><joint name="bar"/><geom fromto="0 0 0 .2 0 0"/></body>
  </body>
  <body name="rocker" pos=".2 0 0"><joint name="rocker"/><geom fromto="0 0 0 0 0 .12"/>
    <body name="arm" pos="0 0 .1"><joint name="arm" range="-60 60"/><geom fromto="0 0 0 .1 0 .1"/></body>
  </body>
</worldbody>
<equality><connect body1="bar" body2="rocker" anchor=".2 0 0"/></equality>
<actuator><motor name="c" joint="crank"/><motor name="a" joint="arm"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def arm():
    return load_mechanism(ARM_ON_A_LOOP)


@pytest.fixture(scope="module")
def swept(arm):
    s = np.tile(arm.home[arm.independent], (40, 1))
    s[:, 1] += np.linspace(0.0, 0.9, 40)
    return follow(arm, s)


def test_the_coordinates_of_loops_are_known(arm):
    assert [joint.name for joint in arm.independent_joints] == ["crank", "arm"]
    assert in_loops(arm).tolist() == [True, False]
    assert not in_loops(load_mechanism("cart-pole")).any()


def test_what_moves_outside_the_loops_leaves_them_alone(arm, swept):
    assert np.ptp(swept[:, arm.independent[1]]) == pytest.approx(0.9)
    assert np.all(swept[:, arm.dependent] == arm.home[arm.dependent])
    np.testing.assert_allclose(swept[-1], advance(arm, arm.home, swept[-1][arm.independent])[0], atol=1e-12)


def test_the_reach_of_a_joint_outside_the_loops_is_its_range(arm):
    can = reach(arm, 1)
    assert np.degrees([can.lower.position, can.upper.position]) == pytest.approx([-60, 60])
    assert (can.singular, toggles(arm, 1)) == ((), ())


def rigid(mechanism: Mechanism) -> np.ndarray:
    """Return the inertia of each coordinate with closed loops, the others free."""
    return 1.0 / np.linalg.inv(np.array(mechanism.dynamics.reduced_inertia(mechanism.home))).diagonal()


def simulated(mechanism: Mechanism) -> np.ndarray:
    """Return one over MuJoCo's own accelerations by a unit force on each coordinate, less those without."""
    model, found = copy.copy(mechanism.model), []
    data = mujoco.MjData(model)
    model.opt.tolerance, model.opt.iterations, model.opt.disableflags = 0.0, 200, mujoco.mjtDisableBit.mjDSBL_WARMSTART
    model.dof_frictionloss[:] = 0.0  # sliding friction does not depend on the acceleration
    data.qpos[:] = mechanism.qpos_of(mechanism.home)
    mujoco.mj_forward(model, data)
    still = data.qacc.copy()
    for joint in mechanism.independent_joints:
        dof = model.joint(joint.name).dofadr[0]
        data.qfrc_applied[:] = 0.0
        data.qfrc_applied[dof] = 1.0
        mujoco.mj_forward(model, data)
        found.append(1.0 / (data.qacc - still)[dof])
    return np.array(found)


def test_behind_stiff_loops_a_drive_feels_the_whole_mechanism():
    mechanism = load_mechanism(ankle_text())
    assert felt_inertia(mechanism, mechanism.home) == pytest.approx(rigid(mechanism), rel=0.02)


def test_behind_soft_loops_a_drive_feels_little_more_than_its_own_link():
    mechanism = load_mechanism(soft_ankle(1e-6))
    felt = felt_inertia(mechanism, mechanism.home)
    assert felt.min() < 0.9 * rigid(mechanism)[felt.argmin()]
    assert felt == pytest.approx(simulated(mechanism), rel=1e-3)


def test_contacts_asked_for_between_parts_that_stand_still_do_not_count():
    """MuJoCo makes room for their rows in its Jacobian, and leaves them out."""
    mechanism = load_mechanism(
        """<mujoco><worldbody><geom name="a" size="0.1"/><body pos="0.1 0 0"><geom name="b" size="0.1"/></body>
          <body pos="0 3 0"><joint name="arm" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0" mass="2"/></body></worldbody>
          <contact><pair geom1="a" geom2="b"/></contact>
          <actuator><motor joint="arm" ctrlrange="-9 9"/></actuator></mujoco>"""
    )
    assert felt_inertia(mechanism, mechanism.home) == pytest.approx([2 * (0.2**2 + 0.4 * 0.1**2)])


def test_functions_with_many_values_are_not_mapped_over_samples(arm, swept, monkeypatch):
    """Both ways give the same values, and the rates are those of the velocity map."""
    gamma, v = sampled(arm.dynamics.velocity_map, swept), np.linspace(0.0, 1.0, 80).reshape(40, 2)
    np.testing.assert_allclose(joint_rates(arm, swept, v), np.einsum("kqs,ks->kq", gamma, v), atol=1e-12)
    monkeypatch.setattr(along, "MAX_MAPPED", gamma[0].size - 1)
    monkeypatch.setattr(along, "mapped", lambda *_: pytest.fail("the function was mapped"))
    np.testing.assert_array_equal(sampled(arm.dynamics.velocity_map, swept), gamma)
