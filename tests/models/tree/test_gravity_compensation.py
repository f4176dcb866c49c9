"""Gravity compensation against MuJoCo's, on a leg and on a linkage with ball joints."""

import mujoco
import numpy as np
import pytest

from linkplan.models.audit import audit
from linkplan.models.mechanism import load_mechanism
from tests.support.linkages import LEG, RSSR
from tests.support.mechanisms import replaced
from tests.support.tolerances import TREE, relative_error

TEXTS = {
    "leg": replaced(LEG, '<body name="thigh">', '<body name="thigh" gravcomp="0.7">'),
    "rod on a ball": replaced(RSSR, '<body name="rod" ', '<body name="rod" gravcomp="1" '),
    "carried by an actuator": replaced(
        replaced(LEG, '<body name="thigh">', '<body name="thigh" gravcomp="1">'),
        '<joint name="pitch"/>',
        '<joint name="pitch" actuatorgravcomp="true"/>',
    ),
}


@pytest.mark.parametrize("name", TEXTS)
def test_passive_forces_are_mujocos_with_gravity_compensation(name):
    mechanism = load_mechanism(TEXTS[name])
    model, data = mechanism.model, mujoco.MjData(mechanism.model)
    rng = np.random.default_rng(2)
    for _ in range(3):
        q = mechanism.home + rng.uniform(-0.5, 0.5, mechanism.n_q)
        rates = rng.normal(size=mechanism.n_q)
        data.qpos[:], data.qvel[:] = mechanism.qpos_of(q), mechanism.qvel_of(q, rates)
        mujoco.mj_forward(model, data)
        assert np.abs(data.qfrc_gravcomp).max() > 1e-3, "it acts"
        T = np.array([mechanism.qvel_of(q, e) for e in np.eye(mechanism.n_q)]).T
        forces = data.qfrc_passive + np.where(model.jnt_actgravcomp[model.dof_jntid], data.qfrc_gravcomp, 0.0)
        assert relative_error(np.array(mechanism.dynamics.passive(q, rates)).ravel(), T.T @ forces) < TREE


def test_what_compensation_carries_is_no_weight_and_the_model_is_planned_as_it_is():
    text = LEG.replace("<body ", '<body gravcomp="1" ')
    mechanism = load_mechanism(text)
    assert np.abs(np.array(mechanism.dynamics.gravity_effort(mechanism.home))).max() < 1e-12
    assert not [one for one in audit(mechanism.model) if one.falsifies]


def test_compensation_that_joints_clamp_is_named_once_with_what_to_change():
    text = LEG.replace("<body ", '<body gravcomp="1" ')
    for joint in ("yaw", "pitch"):
        clamped = f'<joint name="{joint}" actuatorgravcomp="true" actuatorfrcrange="-9 9"'
        text = text.replace(f'<joint name="{joint}"', clamped)
    (found,) = [one.text for one in audit(load_mechanism(text).model) if one.falsifies]
    assert found.startswith("gravcomp of body hip and 4 more, clamped by the actuatorfrcrange of joint yaw and 1 more")
    free = text.replace(' actuatorgravcomp="true"', "")
    assert not [one for one in audit(load_mechanism(free).model) if one.falsifies]
