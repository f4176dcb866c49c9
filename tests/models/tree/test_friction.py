"""Dry friction in the reduced dynamics: Coulomb's against MuJoCo's constraint forces, gradual about rest."""

import mujoco
import numpy as np
import pytest

import linkplan
from linkplan.models.audit import audit
from linkplan.models.errors import ModelError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.along import sliding_friction
from linkplan.models.tree.friction import frictions_of, viscous_below
from tests.support.bodies import RUBBED_ARM
from tests.support.linkages import GRIPPER, RSSR, WELDED
from tests.support.mechanisms import replaced
from tests.support.tolerances import TREE, relative_error

RUBBED = WELDED.replace('"/><geom type="capsule"', '" frictionloss="0.3"/><geom type="capsule"')
MODELS = {
    "every hinge": RUBBED,
    "a ball": replaced(RSSR, 'type="ball"', 'type="ball" frictionloss="0.1"'),
    "a slide and a tendon": replaced(
        replaced(GRIPPER, '<fixed name="split">', '<fixed name="split" frictionloss="0.2">'),
        'type="slide" axis="0 0 1"',
        'type="slide" axis="0 0 1" frictionloss="2"',
    ),
}


def in_mujoco(mechanism, q: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return MuJoCo's generalised force (n_q,) of dry friction alone."""
    model, data = mechanism.model, mujoco.MjData(mechanism.model)
    data.qpos[:], data.qvel[:] = mechanism.qpos_of(q), mechanism.qvel_of(q, rates)
    mujoco.mj_forward(model, data)
    rows = np.isin(data.efc_type, [mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF, mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON])
    assert rows.any(), "MuJoCo has the friction that is asked for"
    force = np.zeros(model.nv)
    mujoco.mj_mulJacTVec(model, data, force, np.where(rows, data.efc_force, 0.0))
    return force


@pytest.mark.parametrize("name", MODELS)
def test_sliding_fast_friction_is_mujocos(name):
    # At so short a step MuJoCo's friction follows the speed alone: at a longer one braking turns it round.
    mechanism = load_mechanism(replaced(MODELS[name], "<compiler", '<option timestep="1e-6"/><compiler'), solref="stiff")
    q, rng = mechanism.home, np.random.default_rng(1)
    gamma = np.array(mechanism.dynamics.velocity_map(q))
    T = np.array([mechanism.qvel_of(q, rate) for rate in np.eye(mechanism.n_q)]).T
    for _ in range(4):
        v, none = rng.normal(size=mechanism.dof) * 40.0, np.zeros(mechanism.n_u)
        motion = (q, v, np.zeros(mechanism.dof), none)
        rub = np.array(mechanism.dynamics.residual(*motion) - mechanism.dynamics.sliding(*motion)).ravel()
        expected = -gamma.T @ T.T @ in_mujoco(mechanism, q, gamma @ v)
        assert np.abs(expected).max() > 0.01, "it rubs"
        assert relative_error(rub, expected) < TREE


def test_at_rest_it_is_nothing_and_turns_over_with_the_speed_asked():
    for speed in (0.005, 0.05):
        arm = load_mechanism(RUBBED_ARM, friction_transition=speed).dynamics
        force = [float(arm.inverse_dynamics(0.0, v, 0.0)) for v in (0.0, speed, -speed, 10 * speed)]
        assert np.allclose(force, [0.0, 0.5 * np.tanh(1.0), -0.5 * np.tanh(1.0), 0.5])


def test_linearised_at_rest_it_is_no_damper():
    rubbed, smooth = load_mechanism(RUBBED), load_mechanism(WELDED)
    at = (smooth.home, [0.0], [0.4])
    assert float(rubbed.dynamics.inverse_dynamics(smooth.home, 1.0, 0.0)) > 0.3, "it rubs"
    for with_it, without in zip(rubbed.dynamics.linearisation(*at), smooth.dynamics.linearisation(*at), strict=True):
        assert relative_error(np.array(with_it), np.array(without)) < TREE


def test_a_mechanism_that_moves_on_is_rubbed_by_all_its_joints():
    mechanism = load_mechanism(RUBBED)
    gamma = np.array(mechanism.dynamics.velocity_map(mechanism.home))[:, 0]
    rub = sliding_friction(mechanism, mechanism.home[None])
    assert np.allclose(rub, sum(0.3 * abs(gamma[one.dof]) for one in frictions_of(mechanism.model)))


def test_the_simulators_own_gives_way_below_the_speed_that_is_named():
    model = load_mechanism(RUBBED_ARM).model
    (one,) = frictions_of(model)
    slowest = viscous_below(model, one)
    assert slowest > 1e-3
    for share, expected in ((0.5, 0.5), (0.9, 0.9), (1.1, 1.0), (3.0, 1.0)):
        data = mujoco.MjData(model)
        data.qvel[:], data.qfrc_applied[:] = share * slowest, expected * one.force  # carried on at that speed
        mujoco.mj_forward(model, data)
        assert abs(data.qfrc_constraint[0] / one.force + expected) < 0.02


def test_stiff_makes_the_simulators_friction_dry():
    model = load_mechanism(RUBBED_ARM, solref="stiff").model
    (one,) = frictions_of(model)
    assert viscous_below(model, one) < 0.02 * viscous_below(load_mechanism(RUBBED_ARM).model, one)


def test_friction_is_honoured_and_noted_by_name():
    mechanism = load_mechanism(MODELS["a slide and a tendon"])
    assert not [item for item in audit(mechanism.model) if item.falsifies]
    (note,) = [note for note in mechanism.notes if "dry friction" in note]
    assert "joint lift 2 N" in note
    assert "tendon split 0.2 N.m" in note
    assert "mechanism.friction_transition_deg_s" in note
    switched_off = RUBBED_ARM.replace('timestep="1e-3"/>', '><flag frictionloss="disable"/></option>')
    assert not load_mechanism(switched_off).notes


@pytest.mark.parametrize("speed", [0.0, -1.0, np.nan, 1e3, True, "slow"])
def test_a_transition_that_is_no_speed_is_refused(speed):
    with pytest.raises(ModelError, match="friction_transition_deg_s"):
        linkplan.load_mechanism(RUBBED_ARM, friction_transition_deg_s=speed)
