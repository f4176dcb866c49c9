"""The inertia that a drive feels in the model's own simulation, from which gains and LQR's weights follow."""

import copy

import mujoco
import numpy as np
import pytest

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.felt_inertia import felt_inertia
from tests.support.parallel_ankle import ankle_text, soft_ankle


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
